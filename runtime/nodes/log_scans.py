"""The scans of a log, as processing takes them: the door between files and algorithms."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from processing.scan import Beams, Scan
from runtime.formats.laser_log import LaserLog
from runtime.formats.logs import open_log
from runtime.formats.stamp_holes import missing_before
from runtime.nodes.missed import Missed


def beams_of(log: LaserLog) -> Beams:
    """Return the geometry of a log, rounded to single precision as every message carries it."""
    g = log.geometry
    return Beams(
        count=g.count,
        angle_min_rad=g.angle_min_rad,
        angle_increment_rad=g.angle_increment_rad,
        time_increment_s=g.time_increment_s,
        period_s=g.period_s,
        range_min_m=g.range_min_m,
        range_max_m=g.range_max_m,
    )


def iterate(log: LaserLog) -> Iterator[Scan]:
    """Yield every scan in file order under its raw stamp."""
    for scan, _ in counted(log):
        yield scan


def counted(log: LaserLog) -> Iterator[tuple[Scan, int]]:
    """Yield every scan as `iterate` does, and how many before it never came into the log.

    They are counted as the live matcher counts them, so that both go over a hole in the same way; where scans
    have no numbers, the stamps around a hole must agree on it.
    """
    beams = beams_of(log)
    missed = Missed()
    missing = missing_before(log.stamps_ns, beams.period_s).tolist()
    for record, before in zip(log, missing, strict=True):
        if record.sequence:
            before = missed.before(record.publisher, record.sequence, record.stamp_ns, beams.period_s)
        yield Scan(record.stamp_ns, record.ranges_m, beams), before


def by_stamps(scans: Sequence[Scan]) -> Iterator[tuple[Scan, int]]:
    """Yield scans without numbers, N >= 1, and how many before each never came: see `missing_before`."""
    stamps_ns = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
    yield from zip(scans, missing_before(stamps_ns, scans[0].beams.period_s).tolist(), strict=True)


def scans_of(path: Path | str, topic: str | None = None) -> tuple[Beams, Iterator[Scan]]:
    """Open a log of any format: its beams, and an iterator over all its scans."""
    log = open_log(Path(path), topic)
    return beams_of(log), iterate(log)
