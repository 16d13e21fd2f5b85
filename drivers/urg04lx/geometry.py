"""Where each value of a scan points, when it was taken, what it means, and what fits through a line.

Steps count counter-clockwise seen from above; step 384 looks straight ahead, so 44 .. 725 is not symmetric.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.urg04lx.information import Parameters
from drivers.urg04lx.protocol import ERROR_LIMIT, LINE_CHARS, MS_LIMIT_MM, StreamRequest

GUARANTEED_MM = 4095
"""Beyond it a value is a good target's luck: kept, and counted."""
RS232_BAUDS = (19_200, 57_600, 115_200, 250_000, 500_000, 750_000)
"""What the sensor can be set to; 38400 is not among them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """The rays of every scan of one request to one sensor; rad, s, m, laser frame."""

    count: int
    angle_min_rad: float
    angle_increment_rad: float
    first_ray_s: float
    """From step 0, whose time the sensor reports, to the first ray."""
    time_increment_s: float
    period_s: float
    """From one reported scan to the next."""
    range_min_m: float
    range_max_m: float

    @classmethod
    def of(cls, request: StreamRequest, sensor: Parameters) -> "Sweep":
        """Work out the rays; a group of steps points where its middle points."""
        step_rad = 2.0 * np.pi / sensor.steps_per_turn
        turn_s = 60.0 / sensor.turns_per_minute
        step_s = turn_s / sensor.steps_per_turn
        first = request.first_step + (request.cluster - 1) / 2
        return cls(
            count=request.count,
            angle_min_rad=(first - sensor.front_step) * step_rad,
            angle_increment_rad=request.cluster * step_rad,
            first_ray_s=first * step_s,
            time_increment_s=request.cluster * step_s,
            period_s=turn_s * (request.skip + 1),
            range_min_m=sensor.range_min_mm / 1000,
            range_max_m=sensor.range_max_mm / 1000,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Ranges:
    """The values of a scan as ranges, with what was found among them."""

    metres: NDArray[np.float32]
    """(count,) NaN where the sensor reports an error: no information, neither near nor far."""
    codes: NDArray[np.int64]
    """(20,) how many values were each error code."""
    beyond: int
    """Values over the guaranteed 4095 mm; they are kept."""
    impossible: int
    """Values over the sensor's own maximum, or at the upper end of two characters; no information."""


def to_ranges(values: NDArray[np.int32], request: StreamRequest, sensor: Parameters) -> Ranges:
    """Tell distances (N,) mm from error codes.

    A 4095 in two characters says "this or more", which is no distance: it would draw a wall out of nothing.
    """
    error = values < ERROR_LIMIT
    impossible = values > sensor.range_max_mm if request.wide else values >= MS_LIMIT_MM
    metres = np.where(error | impossible, np.nan, values / 1000.0).astype(np.float32)
    return Ranges(
        metres,
        np.bincount(values[error], minlength=ERROR_LIMIT),
        int(np.count_nonzero((values > GUARANTEED_MM) & ~impossible)),
        int(np.count_nonzero(impossible)),
    )


def reply_bytes(request: StreamRequest) -> int:
    """Return the size of one scan on the line."""
    chars = request.count * request.width
    return 15 + 1 + 4 + 6 + chars + 2 * -(-chars // LINE_CHARS) + 1


def check_budget(request: StreamRequest, baud: int, turn_s: float = 0.1) -> None:
    """Refuse what a line cannot carry in time; nobody knows what the sensor does then.

    Args:
        request: What would be asked for.
        baud: Rate of the RS-232 line, 10 bits a byte.
        turn_s: One revolution.

    Raises:
        ValueError: A scan takes longer than the time until the next one.
    """
    scan_s, room_s = reply_bytes(request) * 10 / baud, turn_s * (request.skip + 1)
    if scan_s > room_s:
        raise ValueError(
            f"baud = {baud}: {reply_bytes(request)} bytes a scan take {scan_s * 1e3:.1f} ms, there are"
            f" {room_s * 1e3:.0f} ms; use 500000 baud, or wide: false with cluster 2, or skip scans"
        )
