"""Every topic in one table: its type, its rate, what a subscription keeps, and who gets the last one.

One publisher for each topic, except the shared ones, on which every process speaks.
"""

import enum
from dataclasses import dataclass

from runtime.errors import ConfigError
from runtime.guess import meant

NEWEST = 1
"""A subscription that works on the present: what was not taken in time is overwritten, and counted."""
ALL = 256
"""A subscription that wants everything: a bounded queue; when full the oldest is dropped, and counted."""


class Urgency(enum.IntEnum):
    """What goes first where a link is slow; the greater waits for the smaller."""

    COMMAND = 1
    """Moves or stops the robot: before everything, and sent without waiting for company."""
    WHERE = 2
    """Where the robot is, in a few hundred bytes."""
    DATA = 3
    DETAIL = 4
    """Nice to look at."""
    BULK = 5
    """Large; comes again."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the table."""

    name: str
    type: str
    rate_hz: float
    """At which its publisher promises to speak; 0 where it speaks when something happened."""
    keep: int = NEWEST
    """How many messages a subscription holds until they are taken."""
    latched: bool = False
    """Whether a subscriber that comes late gets the last message at once."""
    shared: bool = False
    """Whether several processes may publish it."""
    recorded: bool = True
    urgency: Urgency = Urgency.DATA
    elsewhere: bool = False
    """Whether a process on another machine may publish it; devices speak on the robot's own."""

    @property
    def period_ns(self) -> int:
        """Time between two messages; 0 without a rate."""
        return round(1e9 / self.rate_hz) if self.rate_hz else 0


TOPICS: dict[str, Topic] = {
    topic.name: topic
    for topic in (
        Topic("scan", "sensor_msgs/msg/LaserScan", 10.0),
        Topic("odom", "nav_msgs/msg/Odometry", 10.0, keep=64, urgency=Urgency.WHERE, elsewhere=True),
        Topic("match_points", "sensor_msgs/msg/PointCloud2", 10.0, urgency=Urgency.DETAIL, elsewhere=True),
        Topic(
            "pose", "geometry_msgs/msg/PoseWithCovarianceStamped", 10.0, urgency=Urgency.WHERE, elsewhere=True
        ),
        Topic("map", "nav_msgs/msg/OccupancyGrid", 0.0, latched=True, urgency=Urgency.BULK, elsewhere=True),
        Topic(
            "map_updates",
            "map_msgs/msg/OccupancyGridUpdate",
            0.0,
            keep=ALL,
            urgency=Urgency.BULK,
            elsewhere=True,
        ),
        Topic("particles", "geometry_msgs/msg/PoseArray", 0.0, urgency=Urgency.DETAIL, elsewhere=True),
        Topic("trajectory", "nav_msgs/msg/Path", 0.0, latched=True, urgency=Urgency.BULK, elsewhere=True),
        Topic(
            "tf", "tf2_msgs/msg/TFMessage", 20.0, keep=ALL, shared=True, urgency=Urgency.WHERE, elsewhere=True
        ),
        Topic(
            "tf_static", "tf2_msgs/msg/TFMessage", 0.0, latched=True, urgency=Urgency.WHERE, elsewhere=True
        ),
        Topic("cmd_vel", "geometry_msgs/msg/TwistStamped", 0.0, urgency=Urgency.COMMAND, elsewhere=True),
        Topic("battery", "sensor_msgs/msg/BatteryState", 1.0),
        Topic("bumper", "std_msgs/msg/UInt8", 0.0, keep=ALL, urgency=Urgency.WHERE),
        Topic(
            "diagnostics", "diagnostic_msgs/msg/DiagnosticArray", 1.0, keep=ALL, shared=True, elsewhere=True
        ),
        Topic("truth", "geometry_msgs/msg/PoseStamped", 10.0),
        Topic("clock", "rosgraph_msgs/msg/Clock", 0.0, recorded=False),
    )
}


def topic(name: str) -> Topic:
    """Look a topic up.

    Raises:
        ConfigError: There is no such topic; the text guesses which was meant, or lists those there are.
    """
    try:
        return TOPICS[name]
    except KeyError:
        hint = meant(name, TOPICS) or f"; known: {', '.join(TOPICS)}"
        raise ConfigError(f"topic {name!r}: unknown{hint}") from None
