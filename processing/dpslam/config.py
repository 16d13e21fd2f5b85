"""Settings of the mapper; metres, radians. Nobody needs to change them to get a map."""

from dataclasses import dataclass, field

from processing.dpslam.loop_config import LoopConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class DpSlamConfig:
    """DP-SLAM: how many maps it keeps, when it updates them, and how much it trusts what."""

    particles: int = 50
    """Maps kept at once, 1 .. 5000."""
    key_distance_m: float = 0.25
    """A scan is worked into the maps after so much way, 0.02 .. 2, or"""
    key_rotation_rad: float = 0.2
    """after so much turning, 0.02 .. 1."""
    points: int = 134
    """Points of a scan that particles are refined with, 20 .. 1000."""
    rays: int = 134
    """Rays of a scan that particles are weighed with, 10 .. 2000."""
    tempering: float = 0.2
    """How much of a scan's log-likelihood counts, 0.001 .. 1: its rays are not independent."""
    motion_doubt: float = 3.0
    """How many times its standard deviation a motion may be off, 1 .. 20: neighbours err to the same side."""
    prior_m: float = 0.06
    """How far the own map may pull a particle from the motion (one sigma), 0.001 .. 1."""
    prior_rad: float = 0.02
    """The same in rotation, 0.001 .. 0.5."""
    memory: float = 60.0
    """Observations of a cell after which it starts to forget, 5 .. 150: what has moved away fades."""
    range_max_m: float = 50.0
    """Readings farther away are left out of the maps, 1 .. 1000."""

    close_loops: bool = True
    """Whether the path is smoothed when the laser comes back to old ground."""
    loops: LoopConfig = field(default_factory=LoopConfig)

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} = {value}, must be in [{low:g}, {high:g}]")


_RANGES = {
    "particles": (1, 5000),
    "key_distance_m": (0.02, 2.0),
    "key_rotation_rad": (0.02, 1.0),
    "points": (20, 1000),
    "rays": (10, 2000),
    "tempering": (0.001, 1.0),
    "motion_doubt": (1.0, 20.0),
    "prior_m": (0.001, 1.0),
    "prior_rad": (0.001, 0.5),
    "memory": (5, 150),
    "range_max_m": (1.0, 1000.0),
}
