"""Scripted operator: sees where the robot is, as somebody in the building would, and drives it along a route.

It obeys the rules a person has to obey: it holds the stick at zero before it arms, arms again after the robot
stopped by itself, and lets an emergency stop stand.
"""

from dataclasses import dataclass, field
from typing import Any

from drivers.create.operators import Intent
from drivers.world import BUILDINGS, BuildingName, Pursuit, PursuitConfig
from runtime.nodes.convert import pose_from_message
from runtime.nodes.steering import steering_message
from runtime.port import Port

SUBSCRIBES: tuple[str, ...] = ("truth", "diagnostics")
PUBLISHES: tuple[str, ...] = ("cmd_vel",)

_NEUTRAL_NS = 300_000_000
_ASK_AGAIN_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """Which route, and how fast."""

    building: BuildingName = "demo"
    name: str = "script"
    """Of the operator, as the base tells it to others."""
    base: str = "base"
    """Name of the process that drives the robot."""
    pursuit: PursuitConfig = field(default_factory=PursuitConfig)


def run(port: Port, config: Config) -> int:
    """Drive until the port stops, or an open route ends."""
    building = BUILDINGS[config.building]()
    pursuit = Pursuit(building.route, building.closed, config.pursuit)
    script = _Script(port, config)
    truth = port.subscribe("truth")
    diagnostics = port.subscribe("diagnostics")
    port.ready()
    while not port.stopping:
        received = truth.wait(0.1)
        for heard in diagnostics.drain():
            script.hear(heard.message)
        if received is None:
            continue  # blind: no input at all, and the base stops by itself
        if script.state != "armed":
            script.prepare()
            port.report("ok", f"robot is {script.state or 'not heard yet'}")
        else:
            speed, turn = pursuit.command(pose_from_message(received.message.pose))
            script.steer(speed, turn)
            port.report("ok", "at the end of the route" if pursuit.done else "driving", laps=pursuit.laps)
    script.steer(0.0, 0.0)
    return 0


class _Script:
    """The hand on the stick."""

    def __init__(self, port: Port, config: Config) -> None:
        self._port, self._name = port, config.name
        self._base = f"{port.robot}/{config.base}"
        self.state = ""
        """What the base said last."""
        self._neutral_ns: int | None = None
        self._asked_ns = 0

    def hear(self, message: Any) -> None:
        """Read what the base says of itself; others speak on the same topic."""
        for status in message.status:
            if status.name == self._base:
                values = {entry.key: entry.value for entry in status.values}
                self.state = values.get("state", "")

    def prepare(self) -> None:
        """Hold the stick at zero, and ask to be let drive from time to time."""
        now_ns = self._port.clock.now_ns()
        if self._neutral_ns is None:
            self._neutral_ns = now_ns
        ready = now_ns - self._neutral_ns > _NEUTRAL_NS and now_ns - self._asked_ns > _ASK_AGAIN_NS
        ask = ready and self.state == "disarmed"
        if ask:
            self._asked_ns = now_ns
        self._send(0.0, 0.0, Intent.ARM if ask else Intent.DRIVE)

    def steer(self, speed_mps: float, turn_rate_radps: float) -> None:
        """Move the stick."""
        self._neutral_ns = None
        self._send(speed_mps, turn_rate_radps, Intent.DRIVE)

    def _send(self, speed_mps: float, turn_rate_radps: float, intent: Intent) -> None:
        now_ns = self._port.clock.now_ns()
        message = steering_message(self._name, now_ns, speed_mps, turn_rate_radps, intent)
        self._port.publish("cmd_vel", message)
