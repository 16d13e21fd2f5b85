"""Laser logs as text again: CARMEN and tinySLAM, as far as each can hold a log.

Every writer returns, in words, what its format could not hold; nothing is changed in silence.
"""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.formats import carmen, tinyslam
from runtime.formats.errors import FormatError
from runtime.formats.laser_log import LaserLog

FLASER_NO_ECHO_M = "81.83"
_MAX_MM = round(tinyslam.RANGE_MAX_M * 1000)


def exact_stamp(stamp_ns: int) -> str:
    """Print a stamp in seconds with six decimals, or with nine where six would round it."""
    seconds, nanos = divmod(stamp_ns, 1_000_000_000)
    return f"{seconds}.{nanos // 1000:06d}" if nanos % 1000 == 0 else f"{seconds}.{nanos:09d}"


def write_carmen(path: Path, log: LaserLog) -> list[str]:
    """Write a log as CARMEN: `FLASER` for a fan of 180 degrees, else `ROBOTLASER1`; return what was lost."""
    g = log.geometry
    half_circle = math.isclose(g.angle_min_rad, -math.pi / 2, abs_tol=1e-6) and math.isclose(
        g.angle_increment_rad, math.pi / max(g.count - g.count % 2, 1), rel_tol=1e-6
    )
    limit_m = carmen.NO_ECHO_M if half_circle else min(g.range_max_m, carmen.NO_ECHO_M)
    too_far, began_ns = 0, int(log.stamps_ns[0])
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write("# CARMEN Logfile\n")
        for record in log:
            ranges = record.ranges_m
            too_far += int(np.count_nonzero(np.isfinite(ranges) & (ranges >= limit_m)))
            no_echo = FLASER_NO_ECHO_M if half_circle else _shortest(limit_m)
            readings = " ".join(_reading(float(r), str(r), no_echo) for r in ranges)
            stamp = exact_stamp(record.stamp_ns)
            tail = f"{stamp} hallway {exact_stamp(max(record.stamp_ns - began_ns, 0))}\n"
            if half_circle:
                file.write(f"FLASER {g.count} {readings} 0 0 0 0 0 0 {tail}")
            else:
                fan = (
                    f"{g.angle_min_rad!r} {g.angle_increment_rad * (g.count - 1)!r} {g.angle_increment_rad!r}"
                )
                head = f"ROBOTLASER1 0 {fan} {_shortest(limit_m)} 0.01 0 {g.count}"
                file.write(f"{head} {readings} 0 0 0 0 0 0 0 0 0 0 0 0 {tail}")
    lost = ["the period, which is estimated again from the stamps"]
    read_s = carmen.time_increment_s(g.count, g.angle_increment_rad)
    if not math.isclose(g.time_increment_s, read_s, rel_tol=1e-3):
        lost.append(f"time_increment = {g.time_increment_s:g} s, which is read as {read_s:g} s")
    if half_circle:
        lost.append(f"range limits {g.range_min_m:g} .. {g.range_max_m:g} m")
    if too_far:
        lost.append(f"{too_far} readings of {limit_m:g} m or more, which mean no echo there")
    return lost


def write_tinyslam(path: Path, log: LaserLog) -> list[str]:
    """Write a log as tinySLAM text, which knows one sensor only; return what was lost.

    Raises:
        FormatError: The scans are not those of a URG-04LX with 682 beams.
    """
    g = log.geometry
    first_rad = -tinyslam.FRONT_BEAM * tinyslam.STEP_RAD
    fits = g.count == tinyslam.BEAMS and math.isclose(g.angle_increment_rad, tinyslam.STEP_RAD, rel_tol=1e-5)
    if not fits or not math.isclose(g.angle_min_rad, first_rad, abs_tol=1e-4):
        rule = (
            f"{g.count} beams from {g.angle_min_rad:.4f} rad by {g.angle_increment_rad:.6f} rad;"
            f" tinySLAM holds {tinyslam.BEAMS} from {first_rad:.4f} by {tinyslam.STEP_RAD:.6f} only"
        )
        raise FormatError(log.path, rule)
    rounded = no_return = cut_off = 0
    with path.open("w", encoding="ascii", newline="\n") as file:
        for record in log:
            ranges = record.ranges_m.astype(np.float64)
            no_return += int(np.isposinf(ranges).sum())
            mm = np.rint(np.where(np.isfinite(ranges), ranges, 0.0) * 1000).astype(np.int64)
            rounded += _count_rounded(record.ranges_m, mm)
            cut_off += int(((mm >= _MAX_MM) | ((mm > 0) & (mm < 20))).sum())
            header = " ".join([str(record.stamp_ns // 1000), *["0"] * 23])
            file.write(f"{header}  {' '.join(map(str, mm.tolist()))} \n")
    lost = ["the period, which is estimated again from the stamps"]
    if fine := int(np.count_nonzero(log.stamps_ns % 1000)):
        lost.append(f"the nanoseconds of {fine} stamps")
    if rounded:
        lost.append(f"fractions of a millimetre of {rounded} readings")
    if no_return:
        lost.append(f"{no_return} readings of no return, which are no information there")
    if cut_off:
        lost.append(f"{cut_off} readings outside 20 .. {_MAX_MM - 1} mm")
    return lost


def _reading(value: float, text: str, no_echo: str) -> str:
    if math.isfinite(value):
        return text
    return no_echo if value > 0 else "0.0"


def _shortest(value: float) -> str:
    """Return the shortest decimal that is this number in single precision."""
    return str(np.float32(value))


def _count_rounded(ranges_m: NDArray[np.float32], mm: NDArray[np.int64]) -> int:
    known = np.isfinite(ranges_m)
    return int(np.count_nonzero((mm[known] / 1000).astype(np.float32) != ranges_m[known]))
