"""What a running device says: that it is connected, scans, and what people should know."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.urg04lx.connect import Identity
from drivers.urg04lx.geometry import Sweep
from drivers.urg04lx.protocol import StreamRequest


@dataclass(frozen=True, slots=True)
class Notice:
    """Something people should know; the newest one describes the present state."""

    level: str
    """ok, warn or error."""
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Connected:
    """The sensor streams from now on."""

    path: str
    baud: int
    identity: Identity
    request: StreamRequest
    sweep: Sweep


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UrgScan:
    """One scan."""

    stamp_ns: int
    """Host time of the first ray, by the clock the device was given."""
    arrival_ns: int
    """Host time of the first byte."""
    sensor_ms: int
    """The sensor's own stamp, of step 0."""
    ranges_m: NDArray[np.float32]
    """(count,) NaN = no information."""
    valid: int
    """How many are distances."""


Event = Notice | Connected | UrgScan
