"""A laser log as every format gives it: one geometry, raw stamps, ranges by REP-117, in file order.

The law: stamps are the file's own digits and are never mended; the period is the rate of the whole log, for
arrival stamps come in bursts and even backwards. A reading is a distance, +inf (nothing returned) or NaN (no
information), never zero.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

DEFAULT_PERIOD_S = 0.1
MAX_PERIOD_S = 10.0
PERIOD_WINDOW = 100
"""Scans over which one estimate of the period is taken: long against bursts, short against pauses."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserGeometry:
    """The rays of the log's scanner, equal in every scan; rad, s, m."""

    count: int
    angle_min_rad: float
    angle_increment_rad: float
    time_increment_s: float
    period_s: float
    range_min_m: float
    range_max_m: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Numbers:
    """What a recording tells beside its scans, by which a scan that never came is noticed."""

    sequences: NDArray[np.int64]
    """(N,) of each scan among those of its publisher, from 1; 0 where it has none."""
    publishers: NDArray[np.int64]
    """(N,) which of them: the first one, the second, ..."""


@dataclass(frozen=True, slots=True, eq=False)
class LaserRecord:
    """One scan of a log."""

    stamp_ns: int
    """As the file prints it."""
    ranges_m: NDArray[np.float32]
    """(count,) NaN = no information, +inf = no return."""
    sequence: int = 0
    """Among the scans of its publisher, from 1; 0 where the format has no numbers."""
    publisher: int = 0
    """Which one: a laser process that was started again is another."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LaserLog:
    """All scans of one laser in one file; iterate over it as often as needed."""

    path: Path
    kind: str
    """Name of the format, for people."""
    topic: str | None
    """Of a bag or recording; None for text."""
    geometry: LaserGeometry
    stamps_ns: NDArray[np.int64]
    """(N,) raw, in file order, not always rising."""
    notices: tuple[str, ...]
    """What a reader should know and may ignore: odd values that were understood."""
    read: Callable[[], Iterator[NDArray[np.float32]]]
    """Start reading the ranges from the first scan."""
    run_seed: int | None = None
    """Of the run that was recorded."""
    run_config: str = ""
    """YAML of the resolved configuration of the run that was recorded."""
    losses: tuple[str, ...] = ()
    """What belongs into the log and is not there: a cut file, scans that were never recorded."""
    gaps: tuple[Mapping[str, Any], ...] = ()
    """Where scans are missing, by their numbers; rows as `runtime.formats.missing.Account.gaps` has them."""
    numbers: Numbers | None = None
    """Of the scans; None where the format has none."""

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __iter__(self) -> Iterator[LaserRecord]:
        if self.numbers is None:
            for stamp_ns, ranges_m in zip(self.stamps_ns.tolist(), self.read(), strict=True):
                yield LaserRecord(stamp_ns, ranges_m)
            return
        beside = (self.stamps_ns, self.numbers.sequences, self.numbers.publishers)
        rows = zip(*(values.tolist() for values in beside), strict=True)
        for (stamp_ns, sequence, publisher), ranges_m in zip(rows, self.read(), strict=True):
            yield LaserRecord(stamp_ns, ranges_m, sequence, publisher)


def clean_ranges(ranges_m: ArrayLike, range_min_m: float, range_max_m: float) -> NDArray[np.float32]:
    """Apply REP-117 to raw readings.

    Args:
        ranges_m: Raw readings, any shape, m.
        range_min_m: Readings below it (and zero, negative, NaN) carry no information.
        range_max_m: Readings at or over it mean that nothing returned.

    Returns:
        The same shape, a new array: distance, NaN or +inf.
    """
    raw = np.asarray(ranges_m, dtype=np.float32)
    ranges = np.where(raw >= np.float32(range_max_m), np.float32(np.inf), raw)
    # Negated, so that NaN falls on the side of no information.
    ranges[~((raw >= np.float32(range_min_m)) & (raw > 0))] = np.nan
    return ranges


def robust_period_s(stamps_ns: NDArray[np.int64]) -> float:
    """Estimate the time from scan to scan: the median over windows of up to `PERIOD_WINDOW` scans.

    Args:
        stamps_ns: (N,) in file order; bursts, pauses and steps backwards do no harm while they are rare.

    Returns:
        The period in seconds; `DEFAULT_PERIOD_S` when the stamps tell none (one scan, equal stamps).
    """
    window = min(PERIOD_WINDOW, len(stamps_ns) // 2)
    if window < 1:
        return DEFAULT_PERIOD_S
    period_s = float(np.median(stamps_ns[window:] - stamps_ns[:-window])) / window / 1e9
    return period_s if 0.0 < period_s <= MAX_PERIOD_S else DEFAULT_PERIOD_S


def stamp_notices(path: Path, stamps_ns: NDArray[np.int64]) -> tuple[str, ...]:
    """Say, in at most one line, that stamps go backwards, and where first."""
    back = np.flatnonzero(np.diff(stamps_ns) < 0)
    if len(back) == 0:
        return ()
    at = int(back[0])
    before, after = stamps_ns[at] / 1e9, stamps_ns[at + 1] / 1e9
    return (
        f"{path}: stamps go backwards {len(back)} times"
        f" (first at scan {at + 2}: {before:.6f} -> {after:.6f} s); the order of the file is kept",
    )


def reading_notices(path: Path, odd: int, first: str) -> tuple[str, ...]:
    """Say, in at most one line, that readings were no distances; `first` is place and value of the first."""
    if odd == 0:
        return ()
    return (f"{path}: {odd} readings are no distance (first at {first}); taken as no information",)
