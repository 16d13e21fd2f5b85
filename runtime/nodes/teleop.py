"""Teleoperation: a person's wishes to `cmd_vel`, and what that person needs to see.

The law of the file: a message carries the time of the person's own input.  While nothing is pressed the
person is present and wants to stand, which is said many times a second; when this process dies, nothing is
said, and the robot stops by itself.
"""

import getpass
import os
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

from runtime.clock import Clock
from runtime.errors import HallwayError
from runtime.nodes import gamepad
from runtime.nodes.keyboard import Wish
from runtime.nodes.steering import steering_message
from runtime.port import Port

SUBSCRIBES: tuple[str, ...] = ("diagnostics", "battery")
PUBLISHES: tuple[str, ...] = ("cmd_vel",)

_POLL_S = 0.05
_SHOW_NS = 100_000_000
_SILENT_NS = 3_000_000_000
_LOST_NS = 5_000_000_000


class NoStickError(HallwayError):
    """There is nothing to steer with."""

    exit_code = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """How fast the stick's end positions are, and who is who."""

    speed_mps: float = 0.3
    turn_rate_radps: float = 1.2
    name: str = ""
    """Of the operator; user, machine and process if empty."""
    base: str = "base"
    """Name of the process that drives the robot."""
    matcher: str = "matcher"

    def __post_init__(self) -> None:
        if not 0.05 <= self.speed_mps <= 0.5:
            raise ValueError(f"speed_mps = {self.speed_mps}, must be in [0.05, 0.5]")
        if not 0.1 <= self.turn_rate_radps <= 4.25:
            raise ValueError(f"turn_rate_radps = {self.turn_rate_radps}, must be in [0.1, 4.25]")
        if ":" in self.name:
            raise ValueError(f"name = {self.name!r}, must not have a colon in it")


class Stick(Protocol):
    """Whatever a person steers with."""

    @property
    def name(self) -> str:
        """What it is, for people."""

    def poll(self, timeout_s: float) -> list[Wish]:
        """Return new wishes, waiting at most `timeout_s` for one."""

    def close(self) -> None:
        """Give it back."""


def run(port: Port, config: Config) -> int:
    """Steer with the first gamepad; a keyboard needs a terminal, and so the command `hallway teleop`."""
    pads = gamepad.attached()
    if not pads:
        raise NoStickError("no gamepad at /dev/input/js*; for the keyboard use `hallway teleop`")
    stick = gamepad.Gamepad(pads[0], port.clock)
    try:
        while steer(port, config, stick) is End.LOST:
            port.count("links_lost")
        return 0
    finally:
        stick.close()


class End(Enum):
    """Why steering ended."""

    LEFT = "the person left"
    LOST = "nothing of the robot was heard for a while"


def steer(
    port: Port,
    config: Config,
    stick: Stick,
    show: Callable[["View"], None] = lambda _: None,
    keep: Callable[[], None] = lambda: None,
) -> End:
    """Turn wishes into messages until the person leaves, the port stops, or the link is lost.

    Args:
        port: The node's door to the bus.
        config: Speeds and names.
        stick: What to steer with.
        show: Called ten times a second with what there is to see.
        keep: Called when the person wants the last minutes kept; returns at once.

    Returns:
        LOST where it is worth a try to connect anew; links do not always come back by themselves.
    """
    name = config.name or own_name()
    view = View(port.robot, config, name, stick.name)
    battery, diagnostics = port.subscribe("battery"), port.subscribe("diagnostics")
    port.ready()
    shown_ns = 0
    heard_ns = port.clock.now_ns()
    leaving = False
    while not (port.stopping or leaving):
        for wish in stick.poll(_POLL_S):
            leaving = leaving or wish.leave
            if wish.keep:
                keep()
                continue
            port.publish("cmd_vel", _message(wish, config, name))
        for received in diagnostics.drain():
            heard_ns = received.received_ns
            view.hear(received.message, received.received_ns)
        for received in battery.drain():
            view.battery = received.message
        now_ns = port.clock.now_ns()
        if now_ns - shown_ns >= _SHOW_NS:
            shown_ns = now_ns
            view.now_ns, view.stick = now_ns, stick.name
            show(view)
            port.report("ok", view.robot_line())
        if now_ns - heard_ns > _LOST_NS:
            return End.LOST
    port.publish("cmd_vel", steering_message(name, port.clock.now_ns()))
    return End.LEFT


def own_name() -> str:
    """Return a name that no other operator has."""
    return f"{getpass.getuser()}@{os.uname().nodename}/{os.getpid()}".replace(":", "-")


def _message(wish: Wish, config: Config, name: str) -> Any:
    speed, turn = wish.speed * config.speed_mps, wish.turn * config.turn_rate_radps
    return steering_message(name, wish.made_ns, speed, turn, wish.intent)


class View:
    """What the person sees: who has the robot, whether it moves, how old the link is, battery, match."""

    def __init__(self, robot: str, config: Config, name: str, stick: str) -> None:
        self.operator, self.stick = name, stick
        self.now_ns = 0
        self.battery: Any = None
        self._base_name, self._matcher_name = f"{robot}/{config.base}", f"{robot}/{config.matcher}"
        self._base: dict[str, str] = {}
        self._matcher: dict[str, str] = {}
        self._heard_ns = {self._base_name: 0, self._matcher_name: 0}

    def hear(self, message: Any, received_ns: int) -> None:
        """Read what the processes say of themselves."""
        for status in message.status:
            if status.name not in self._heard_ns:
                continue
            self._heard_ns[status.name] = received_ns
            values = {entry.key: entry.value for entry in status.values} | {"text": status.message}
            if status.name == self._base_name:
                self._base = values
            else:
                self._matcher = values

    def robot_line(self) -> str:
        """Who steers, and whether the robot moves."""
        if not self._alive(self._base_name):
            return "the robot's driver is not heard"
        holder = self._base.get("operator", "")
        text = self._base.get("text", "")
        if holder and holder != self.operator:
            return f"{holder} has the robot; {text}"
        if refused := self._base.get("refused", ""):
            return f"{text}; {refused} wants it too"
        return text

    def link_line(self) -> str:
        """How old what we know, and what the robot knows of us, is."""
        if not self._alive(self._base_name):
            return "link: none"
        silent_s = (self.now_ns - self._heard_ns[self._base_name]) / 1e9
        age = self._base.get("input_age_s", "")
        ours = self._base.get("operator", "") == self.operator
        theirs = f"our input {float(age) * 1000:.0f} ms old" if ours and age else "our input does not count"
        return f"link: heard {silent_s:.1f} s ago, {theirs} at the robot"

    def battery_line(self) -> str:
        """Volts and, where the robot knows it, share of the charge."""
        if self.battery is None:
            return "battery: not heard"
        share = self.battery.percentage
        known = f", {share:.0%}" if share == share else ""
        return f"battery: {self.battery.voltage:.1f} V{known}"

    def match_line(self) -> str:
        """Whether the laser odometry knows where it is."""
        if not self._alive(self._matcher_name):
            return "match: not heard"
        return f"match: {self._matcher.get('state') or self._matcher.get('text', '')}"

    def lines(self) -> list[str]:
        """Return everything, a line each."""
        return [
            self.robot_line(),
            f"{self.stick} | {self.battery_line()} | {self.match_line()}",
            self.link_line(),
        ]

    def _alive(self, name: str) -> bool:
        heard_ns = self._heard_ns[name]
        return bool(heard_ns) and self.now_ns - heard_ns < _SILENT_NS


def choose_stick(kind: str, clock: Clock, keyboard: Callable[[], Stick]) -> Stick:
    """Return the stick that was asked for: "keyboard", "gamepad", or "any", the gamepad where there is one.

    Raises:
        NoStickError: There is no gamepad, and one was asked for.
    """
    pads = gamepad.attached()
    if kind == "gamepad" and not pads:
        raise NoStickError("no gamepad at /dev/input/js*; is it plugged in or paired?")
    if pads and kind != "keyboard":
        return gamepad.Gamepad(pads[0], clock)
    return keyboard()
