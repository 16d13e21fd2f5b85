"""Ground truth of Kümmerle et al. (2009): `stamp_a stamp_b x y z roll pitch yaw`, pose b seen from pose a."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.formats.errors import FormatError
from runtime.formats.text import lines_of, numbers, stamp_ns

COLUMNS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Relations:
    """Relative poses between scans, named by their raw stamps."""

    stamps_a_ns: NDArray[np.int64]
    stamps_b_ns: NDArray[np.int64]
    a_t_b: NDArray[np.float64]
    """(N, 3) x, y, yaw; m, rad."""

    def __len__(self) -> int:
        return len(self.a_t_b)


def read_relations(path: Path) -> Relations:
    """Read a whole file; FormatError names the line that breaks a rule."""
    stamps: list[tuple[int, int]] = []
    rows: list[list[float]] = []
    for line, text in lines_of(path):
        if text.startswith("#"):
            continue
        tokens = text.split()
        if len(tokens) != COLUMNS:
            rule = f"{len(tokens)} columns, must be {COLUMNS}: stamp_a stamp_b x y z roll pitch yaw"
            raise FormatError(path, rule, line)
        x, y, _, _, _, yaw = numbers(path, line, tokens[2:], "relation value")
        if not np.all(np.isfinite((x, y, yaw))):
            raise FormatError(path, f"relation {x} {y} {yaw}, must be finite", line)
        stamps.append((stamp_ns(path, line, tokens[0]), stamp_ns(path, line, tokens[1])))
        rows.append([x, y, yaw])
    if not rows:
        raise FormatError(path, "0 relations found, must be at least 1")
    both = np.array(stamps, dtype=np.int64)
    return Relations(both[:, 0], both[:, 1], np.array(rows))
