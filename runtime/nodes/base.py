"""Base process: steers an iRobot Create by `cmd_vel`, and publishes how it is; never where it went.

The law of the file: three layers stop the wheels.  `drivers.create.safety` does not believe in old inputs;
this loop tells the robot what it decided, whether or not it changed, and stops it when the supervisor is
gone; a watchdog process stops it when this loop does not turn any more.

How operators speak is in `steering`.
"""

import os
from dataclasses import dataclass, field
from typing import Literal

from drivers.create.device import Create, CreateConfig
from drivers.create.guard import Guard
from drivers.create.limits import SafetyConfig
from drivers.create.safety import Safety, State
from drivers.create.stream import PACKETS, Telemetry
from drivers.errors import DeviceError, PortBusyError, PortForbiddenError, PortMissingError, SilentError
from drivers.transport import SerialStream
from runtime import messages
from runtime.nodes.battery import battery_message
from runtime.nodes.steering import input_of
from runtime.port import Level, Port, Received, Subscription

SUBSCRIBES: tuple[str, ...] = ("cmd_vel",)
PUBLISHES: tuple[str, ...] = ("battery", "bumper")

_TURN_S = 0.02
_WRITE_TIMEOUT_S = 0.2
_BACK_OFF_S = (0.0, 0.5, 1.0, 2.0, 5.0)
_SILENT_NS = 600_000_000
_SECOND_NS = 1_000_000_000
_NO_PORT = (PortMissingError, PortForbiddenError, PortBusyError)
_FAULTLESS = ("not armed", "no input", "emergency stop reset")


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The robot, its line, and its limits."""

    path: str
    """The port's node, e.g. /dev/ttyUSB0; relative paths are looked for in the run's directory."""
    model: Literal["create1", "create2"] = "create1"
    baud: int | None = None
    """The model's own rate if none is given: 57600 for create1, 115200 for create2."""
    packets: tuple[int, ...] = PACKETS
    """Numbers of the sensor packets that the robot sends every 15 ms; at 19200 baud fewer fit."""
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    watchdog_s: float = 0.2
    """After so long without a sign of this process its watchdog stops the robot."""
    patience_s: float = 3.0
    """How long the port may be missing at the start."""

    def __post_init__(self) -> None:
        if not 0.05 <= self.watchdog_s <= 0.25:
            raise ValueError(f"watchdog_s = {self.watchdog_s}, must be in [0.05, 0.25]")
        if not 0.0 <= self.patience_s <= 600.0:
            raise ValueError(f"patience_s = {self.patience_s}, must be in [0, 600]")
        self.device("/dev/null")

    def device(self, path: str) -> CreateConfig:
        """Return the driver's part, checked."""
        return CreateConfig(
            path=path, model=self.model, baud=self.baud, packets=self.packets, safety=self.safety
        )


def run(port: Port, config: Config) -> int:
    """Drive until the port stops; leave the robot in Passive mode."""
    with Guard(config.watchdog_s) as guard:
        base = _Base(port, config, guard)
        try:
            return base.run()
        finally:
            base.leave()


class _Base:
    """One robot, one watchdog, one loop."""

    def __init__(self, port: Port, config: Config, guard: Guard) -> None:
        self._port, self._guard = port, guard
        device = config.device(os.path.join(port.run_dir, config.path))
        self._create = Create(device, self._open_line, self._ending)
        self._safety = Safety(config.safety, device.wheel_base_m)
        self._inputs: Subscription = port.subscribe("cmd_vel", keep=64)
        self._parent = os.getppid()
        self._failures = 0
        self._ever = False
        self._began_ns, self._patience_ns = port.clock.now_ns(), round(config.patience_s * 1e9)
        self._bumps: int | None = None
        self._told: tuple[State, str] | None = None
        self._level: Level = "ok"
        self._reported_ns = self._charged_ns = 0
        self._telemetry: Telemetry | None = None
        self._telemetry_ns = 0

    def run(self) -> int:
        while not self._port.stopping:
            if self._orphaned():
                self._port.report("error", "the supervisor is gone")
                return 1
            try:
                if not self._create.connected:
                    self._connect()
                self._turn()
            except DeviceError as error:
                self._lose(error)
        return 0

    def leave(self) -> None:
        """Stop the robot, and only then let the watchdog go."""
        self._create.close()
        self._guard.take_back()

    def _open_line(self, path: str, baud: int) -> SerialStream:
        return SerialStream(path, baud, timeout_s=_TURN_S, write_timeout_s=_WRITE_TIMEOUT_S)

    def _orphaned(self) -> bool:
        return os.getppid() != self._parent

    def _ending(self) -> bool:
        """Whether to leave; asked several times a second by everything that waits."""
        self._guard.beat(False)
        return self._port.stopping or self._orphaned()

    def _connect(self) -> None:
        self._guard.take_back()  # it holds the lock of the port as long as it holds the line
        self._create.connect()
        self._guard.lend(self._create.fileno())
        self._failures = 0
        self._ever = True
        self._telemetry_ns = self._port.clock.now_ns()
        self._safety.fail("not armed yet")
        self._port.ready()

    def _lose(self, error: DeviceError) -> None:
        """Give the line up, and try again after a while; raise what no waiting will cure."""
        self._safety.fail("no line to the robot")
        self._create.close()
        self._guard.take_back()
        waited_ns = self._port.clock.now_ns() - self._began_ns
        if isinstance(error, _NO_PORT) and not self._ever and waited_ns > self._patience_ns:
            raise error
        self._telemetry = self._told = None
        if self._port.stopping or self._orphaned():
            return
        self._level = "error"
        self._port.report("error", str(error), **self._values(self._port.clock.now_ns()))
        self._port.count("line_failures")
        if isinstance(error, SilentError):
            self._port.ready()  # a robot that is off is no reason to stop everybody else
        wait_s = _BACK_OFF_S[min(self._failures, len(_BACK_OFF_S) - 1)]
        self._failures += 1
        end_ns = self._port.clock.now_ns() + round(wait_s * 1e9)
        while not self._ending() and self._port.clock.now_ns() < end_ns:
            if (received := self._inputs.wait(0.1)) is not None:
                self._hear(received)

    def _turn(self) -> None:
        telemetry = self._create.receive(_TURN_S)
        now_ns = self._port.clock.now_ns()
        if telemetry is not None:
            self._telemetry, self._telemetry_ns = telemetry, now_ns
            self._safety.sense(telemetry, now_ns)
        elif now_ns - self._telemetry_ns > _SILENT_NS:
            raise SilentError(
                f"no data from the robot for {_SILENT_NS / 1e9:g} s: off, reset, or another rate"
            )
        for received in self._inputs.drain():
            self._hear(received)
        if not self._guard.awake and self._safety.state is not State.STOPPED:
            self._renew_guard()
        # Read again: what took long must not make old news look fresh.
        now_ns = self._port.clock.now_ns()
        decision = self._safety.step(now_ns)
        moving = self._safety.state in (State.ARMING, State.ARMED)
        self._guard.beat(moving)
        if decision.enter_safe:
            self._create.enter_safe()
        else:
            self._create.drive(decision.left_mmps, decision.right_mmps)
        if decision.enter_passive:
            self._create.enter_passive()
        self._publish(telemetry, now_ns)

    def _renew_guard(self) -> None:
        self._port.count("watchdogs_lost")
        self._safety.fail("the watchdog was lost")
        self._create.drive(0, 0)
        self._guard.renew()
        self._guard.lend(self._create.fileno())

    def _hear(self, received: Received) -> None:
        given = input_of(received)
        if given is None:
            self._port.count("unknown_inputs")
        else:
            self._safety.hear(given)

    # ---- what it tells ----

    def _publish(self, telemetry: Telemetry | None, now_ns: int) -> None:
        if telemetry is not None and telemetry.bumps_and_drops != self._bumps:
            self._bumps = telemetry.bumps_and_drops
            self._port.publish("bumper", messages.UInt8(data=self._bumps))
        if telemetry is not None and now_ns - self._charged_ns >= _SECOND_NS:
            self._charged_ns = now_ns
            self._port.publish("battery", battery_message(telemetry, now_ns))
        told = (self._safety.state, self._safety.reason)
        if told != self._told or now_ns - self._reported_ns >= _SECOND_NS // 2:
            state_before = self._told[0] if self._told else State.DISARMED
            self._told, self._reported_ns = told, now_ns
            level, text = self._verdict()
            if level == self._level == "ok" and self._safety.state is not state_before:
                self._port.log.info("%s", text)  # the frame logs changes of level only
            self._level = level
            self._port.report(level, text, **self._values(now_ns))

    def _verdict(self) -> tuple[Level, str]:
        state, reason, warnings = self._safety.state, self._safety.reason, self._safety.warnings()
        text = reason if state.value in reason else f"{state.value}: {reason}"
        text = ", ".join((text, *warnings))
        if state is State.STOPPED:
            return "error", text
        at_work = state in (State.ARMING, State.ARMED)
        calm = at_work or (state is State.DISARMED and reason.startswith(_FAULTLESS))
        return ("ok" if calm and not warnings else "warn"), text

    def _values(self, now_ns: int) -> dict[str, object]:
        """Return what a teleoperation shows, and everything that was counted."""
        safety, telemetry = self._safety, self._telemetry
        age_s = safety.input_age_s(now_ns)
        values: dict[str, object] = {
            "state": safety.state.value,
            "reason": safety.reason,
            "operator": safety.operators.holder or "",
            "refused": safety.operators.refused or "",
            "input_stamp_ns": safety.input_stamp_ns(),
            "input_age_s": "" if age_s is None else f"{age_s:.3f}",
            "disarmings": safety.disarmings,
            "watchdog": self._guard.pid,
            "baud": self._create.baud,
        }
        if telemetry is not None:
            values |= {
                "mode": safety.mode(),
                "voltage_v": f"{telemetry.voltage_mv / 1000:.2f}",
                "current_a": f"{telemetry.current_ma / 1000:.2f}",
                "temperature_c": telemetry.temperature_c,
                "charging_state": telemetry.charging_state,
                "on_charger": int(telemetry.on_charger),
                "bumps": telemetry.bumps,
                "wheel_drops": telemetry.wheel_drops,
                "cliffs": telemetry.cliffs,
                "overcurrents": telemetry.overcurrents,
                "wall": int(telemetry.wall),
                "virtual_wall": int(telemetry.virtual_wall),
            }
        return values | safety.operators.counters() | self._create.counters()
