"""Trajectories as TUM text: `stamp x y z qx qy qz qw`, one pose a line, in the order in which they were made.

Stamps are printed in microseconds from their integer, so the digits of a log come back as they were.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.formats.cut import up_to_the_cut
from runtime.formats.errors import FormatError
from runtime.formats.text import Lines, numbers, stamp_ns

COLUMNS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Planar poses under their stamps."""

    stamps_ns: NDArray[np.int64]
    """(N,) in file order."""
    poses: NDArray[np.float64]
    """(N, 3) x, y, yaw; m, rad."""
    losses: tuple[str, ...] = ()
    """What is missing from a file that was cut off."""

    def __len__(self) -> int:
        return len(self.stamps_ns)


def tum_stamp(stamp: int) -> str:
    """Print a stamp as seconds with six decimals, rounded from its nanoseconds."""
    seconds, micros = divmod(kept_ns(stamp) // 1000, 1_000_000)
    return f"{seconds}.{micros:06d}"


def kept_ns(stamp: int) -> int:
    """Return a stamp (ns) as it comes back from a file, which holds microseconds."""
    return (stamp + 500) // 1000 * 1000


def tum_lines(stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> Iterable[str]:
    """Yield one line for each pose (N, 3): micrometres, 1e-9 in the quaternion, whose w is never negative."""
    half_rad = 0.5 * ((poses[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    # Adding zero turns -0.0, which prints with a sign, into 0.0.
    xy, qz, qw = np.round(poses[:, :2], 6) + 0.0, np.round(np.sin(half_rad), 9) + 0.0, np.cos(half_rad)
    for stamp, (x, y), z, w in zip(stamps_ns.tolist(), xy.tolist(), qz.tolist(), qw.tolist(), strict=True):
        yield f"{tum_stamp(stamp)} {x:.6f} {y:.6f} 0.000000 0.000000000 0.000000000 {z:.9f} {w:.9f}\n"


def write_tum(path: Path, stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> None:
    """Write a trajectory; the same arrays give the same bytes."""
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.writelines(tum_lines(stamps_ns, poses))


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory of TUM's eight columns; height, roll and pitch are passed over.

    One whose last line is cut off is read up to there.

    Raises:
        FormatError: Names the line that breaks a rule.
    """
    trajectory, losses = up_to_the_cut(path, partial(_read, path))
    return replace(trajectory, losses=losses)


def _read(path: Path, lines: Lines) -> Trajectory:
    stamps: list[int] = []
    rows: list[list[float]] = []
    for line, text in lines:
        if text.startswith("#"):
            continue
        tokens = text.split()
        if len(tokens) != COLUMNS:
            raise FormatError(
                path, f"{len(tokens)} columns, must be {COLUMNS}: stamp x y z qx qy qz qw", line
            )
        values = numbers(path, line, tokens[1:], "pose value")
        if not np.all(np.isfinite(values)) or not any(values[3:]):
            raise FormatError(path, f"pose {' '.join(tokens[1:])}, must be finite, with a quaternion", line)
        stamps.append(stamp_ns(path, line, tokens[0]))
        rows.append(values)
    if not rows:
        raise FormatError(path, "0 poses found, a trajectory must hold at least 1")
    x, y, _, qx, qy, qz, qw = np.array(rows).T
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
    return Trajectory(np.array(stamps, dtype=np.int64), np.column_stack((x, y, yaw)))
