"""The Wean Hall text format, centimetres: `L x y theta xl yl thetal r1 .. r180 stamp`; `O` is odometry."""

import math
from pathlib import Path

from runtime.formats.errors import FormatError
from runtime.formats.laser_log import LaserLog
from runtime.formats.text import SICK_S_PER_RAD, Lines, ScanTable, numbers, stamp_ns

BEAMS = 180
STEP_RAD = math.pi / BEAMS
NO_ECHO_M = 50.0
_LASER_FIELDS = 1 + 6 + BEAMS + 1
_ODOMETRY_FIELDS = 5


def looks_like(line: str) -> bool:
    """Whether a first line belongs to this format."""
    return line.startswith(("L ", "O "))


def read_wean(path: Path, lines: Lines) -> LaserLog:
    """Read the lines of a log; FormatError names the line that breaks a rule."""
    table = ScanTable(path, "Wean")
    expected = {"L": _LASER_FIELDS, "O": _ODOMETRY_FIELDS}
    for line, text in lines:
        tokens = text.split()
        if tokens[0] not in expected:
            raise FormatError(path, f"line begins with {tokens[0][:20]!r}, must be L or O", line)
        if len(tokens) != expected[tokens[0]]:
            must = expected[tokens[0]]
            rule = f"{tokens[0]} with {len(tokens)} fields, must be {must}: the line is cut or foreign"
            raise FormatError(path, rule, line)
        if tokens[0] == "L":
            ranges_cm = numbers(path, line, tokens[7:-1], "range")
            table.add(line, stamp_ns(path, line, tokens[-1]), [value / 100 for value in ranges_cm])
    return table.finish(
        angle_min_rad=-math.pi / 2,
        angle_increment_rad=STEP_RAD,
        range_max_m=NO_ECHO_M,
        time_increment_s=SICK_S_PER_RAD * STEP_RAD,
    )
