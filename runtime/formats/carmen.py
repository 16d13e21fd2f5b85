"""CARMEN logs: `FLASER` (front laser of 180 degrees) and `ROBOTLASER1` (which tells its own geometry).

Each message is one line: name, contents, ipc time, host, logger time. The ipc time is the stamp of the scan;
published ground truth names scans by it. Odometry and parameters are passed over.
"""

import math
from pathlib import Path

from runtime.formats.errors import FormatError
from runtime.formats.laser_log import LaserLog
from runtime.formats.text import SICK_S_PER_RAD, Lines, ScanTable, numbers, stamp_ns, whole_number

MESSAGES = ("FLASER", "ROBOTLASER1")
_WORDS = (
    "#", "PARAM", "SYNC", "ODOM", "FLASER", "RLASER", "LASER", "ROBOTLASER", "RAWLASER", "TRUEPOS", "IMU",
    "NMEA", "GPS",
)  # fmt: skip
FIELD_OF_VIEW_RAD = math.pi
NO_ECHO_M = 50.0
"""Loggers wrote 50, 80, 81.83 or 81.91 m for "no echo"; no scanner of these logs measures so far indoors."""
_FLASER_TAIL = 9  # x y theta odom_x odom_y odom_theta ipc_time host logger_time
_ROBOTLASER_HEAD = 8
_ROBOTLASER_TAIL = 14  # two poses, tv, rv, two safety distances, turn axis, ipc_time host logger_time


def looks_like(line: str) -> bool:
    """Whether a first line belongs to this format."""
    return line.startswith(_WORDS)


def time_increment_s(count: int, step_rad: float) -> float:
    """Return the time from ray to ray, which these logs do not tell: a SICK LMS's for a half circle."""
    half_circle = math.isclose(step_rad * max(count - count % 2, 1), FIELD_OF_VIEW_RAD, rel_tol=1e-6)
    return SICK_S_PER_RAD * step_rad if half_circle else 0.0


def read_carmen(path: Path, text_lines: Lines) -> LaserLog:
    """Read the lines of a log; of two kinds of laser messages the more frequent one is taken."""
    lines: dict[str, list[tuple[int, list[str]]]] = {name: [] for name in MESSAGES}
    for number, text in text_lines:
        name, _, rest = text.partition(" ")
        if name in lines:
            lines[name].append((number, rest.split()))
        elif not rest and any(message.startswith(name) for message in MESSAGES):
            raise FormatError(path, f"{name!r} alone: the line is cut or foreign", number)
    if not any(lines.values()):
        raise FormatError(path, "0 scans found, a CARMEN log must hold FLASER or ROBOTLASER1 lines")
    # On a tie ROBOTLASER1 wins: both then hold the same scans, and it knows its geometry.
    name = max(MESSAGES, key=lambda one: (len(lines[one]), one == "ROBOTLASER1"))
    return (_read_flaser if name == "FLASER" else _read_robotlaser)(path, lines[name])


def _read_flaser(path: Path, lines: list[tuple[int, list[str]]]) -> LaserLog:
    table = ScanTable(path, "CARMEN FLASER")
    count = 0
    for line, tokens in lines:
        count = whole_number(path, line, tokens[0] if tokens else "", "FLASER readings")
        _check_length(path, line, "FLASER", len(tokens), 1 + count + _FLASER_TAIL)
        ranges_m = numbers(path, line, tokens[1 : 1 + count], "range")
        table.add(line, stamp_ns(path, line, tokens[-3]), ranges_m)
    # 181 and 361 readings hold both ends of the half circle, 180 and 360 only the first.
    steps = max(count - count % 2, 1)
    return table.finish(
        angle_min_rad=-FIELD_OF_VIEW_RAD / 2,
        angle_increment_rad=FIELD_OF_VIEW_RAD / steps,
        range_max_m=NO_ECHO_M,
        time_increment_s=time_increment_s(count, FIELD_OF_VIEW_RAD / steps),
    )


def _read_robotlaser(path: Path, lines: list[tuple[int, list[str]]]) -> LaserLog:
    table = ScanTable(path, "CARMEN ROBOTLASER1")
    first: list[float] = []
    for line, tokens in lines:
        if len(tokens) < _ROBOTLASER_HEAD:
            _check_length(path, line, "ROBOTLASER1", len(tokens), _ROBOTLASER_HEAD)
        count = whole_number(path, line, tokens[7], "ROBOTLASER1 readings")
        remissions = tokens[8 + count] if len(tokens) > 8 + count else "?"
        if not remissions.isdigit():
            raise FormatError(
                path, f"ROBOTLASER1 remission count = {remissions!r}, must be a whole number", line
            )
        expected = _ROBOTLASER_HEAD + count + 1 + int(remissions) + _ROBOTLASER_TAIL
        _check_length(path, line, "ROBOTLASER1", len(tokens), expected)
        geometry = numbers(path, line, tokens[1:5], "laser parameter")
        if first and geometry != first:
            raise FormatError(path, f"laser parameters {geometry}, must stay {first}", line)
        first = geometry
        table.add(line, stamp_ns(path, line, tokens[-3]), numbers(path, line, tokens[8 : 8 + count], "range"))
    start_rad, field_rad, step_rad, max_m = first
    if step_rad <= 0.0:
        step_rad = field_rad / max(count - 1, 1)
    if not (math.isfinite(start_rad) and 0.0 < step_rad < math.pi):
        rule = f"start angle {start_rad}, resolution {step_rad} rad, must be a fan of rays"
        raise FormatError(path, rule, lines[0][0])
    no_echo_m = min(max_m, NO_ECHO_M) if max_m > 0.0 else NO_ECHO_M
    return table.finish(
        angle_min_rad=start_rad,
        angle_increment_rad=step_rad,
        range_max_m=no_echo_m,
        time_increment_s=time_increment_s(count, step_rad),
    )


def _check_length(path: Path, line: int, name: str, found: int, expected: int) -> None:
    if found != expected:
        rule = f"{name} with {found} fields, must be {expected}: the line is cut or foreign"
        raise FormatError(path, rule, line)
