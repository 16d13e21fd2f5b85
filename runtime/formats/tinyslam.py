"""tinySLAM text logs of a URG-04LX: one scan a line, time in us, wheel ticks (unused), 682 ranges in mm.

The last 682 columns are the ranges; 24 or 25 columns stand before them, the same number in every line.
"""

import math
from pathlib import Path

from runtime.formats.errors import FormatError
from runtime.formats.laser_log import LaserLog
from runtime.formats.text import Lines, ScanTable, numbers, stamp_ns

BEAMS = 682
HEADER_COLUMNS = (24, 25)
STEP_RAD = 2.0 * math.pi / 1024
FRONT_BEAM = 340
TIME_INCREMENT_S = 1.0 / 10240
"""The sensor turns ten times a second in 1024 steps."""
RANGE_MIN_M, RANGE_MAX_M = 0.02, 5.6
"""Values under 20 mm are the sensor's error codes."""


def looks_like(line: str) -> bool:
    """Whether a first line belongs to this format: numbers alone, and enough of them to be a header."""
    tokens = line.split()
    try:
        list(map(float, tokens))
    except ValueError:
        return False
    return len(tokens) >= HEADER_COLUMNS[0] and tokens[0].isdigit()


def read_tinyslam(path: Path, lines: Lines) -> LaserLog:
    """Read the lines of a log; FormatError names the line that breaks a rule."""
    table = ScanTable(path, "tinySLAM", zero_is_a_code=True)
    columns = 0
    for line, text in lines:
        tokens = text.split()
        columns = columns or len(tokens)
        if len(tokens) != columns or len(tokens) - BEAMS not in HEADER_COLUMNS:
            allowed = "24 or 25" if len(table) == 0 else str(columns - BEAMS)
            raise FormatError(
                path,
                f"{len(tokens)} columns, must be {allowed} and {BEAMS} ranges: the line is cut or foreign",
                line,
            )
        values = numbers(path, line, tokens[-BEAMS:], "range")
        table.add(line, stamp_ns(path, line, tokens[0], unit_exponent=3), [value / 1000 for value in values])
    return table.finish(
        angle_min_rad=-FRONT_BEAM * STEP_RAD,
        angle_increment_rad=STEP_RAD,
        time_increment_s=TIME_INCREMENT_S,
        range_min_m=RANGE_MIN_M,
        range_max_m=RANGE_MAX_M,
    )
