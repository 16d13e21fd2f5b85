"""What people may set of how loops are closed."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopConfig:
    """When a place counts as known, and how far the path may have drifted."""

    reach_m: float = 15.0
    """Way after which a key scan settles, and how far around it matters: about what the laser sees."""
    drift: float = 0.01
    """Least drift of any scan matcher, a share of the way."""
    drift_rad_per_m: float = 0.004
    """The same in rotation."""
    query_m: float = 4.0
    """Least length of way whose points are searched for together."""
    most_query_m: float = 12.0
    """Most of it: the farther the path may have drifted, the more must be recognised."""
    try_every_m: float = 1.0
    """Way between two looks for a place that is known."""
    least_score: float = 0.6
    """Share of the searched points that must find their wall."""
    rival_ratio: float = 0.95
    """A second place that fits so nearly as well makes the first one nobody's."""
    far_rival_ratio: float = 0.85
    """The same where the path may have drifted by more than half a metre: corridors repeat themselves."""
    most_window_m: float = 10.0
    """Farthest from where the path is that a known place is looked for, however far it may have drifted."""
    most_window_rad: float = 0.8
    """The same in rotation."""

    def __post_init__(self) -> None:
        for name in (
            "reach_m",
            "drift",
            "query_m",
            "most_query_m",
            "try_every_m",
            "most_window_m",
            "most_window_rad",
        ):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} = {getattr(self, name)}, must be positive")
        for name in ("least_score", "rival_ratio", "far_rival_ratio"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"{name} = {getattr(self, name)}, must be in (0, 1]")
