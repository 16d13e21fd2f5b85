"""Drive a running robot by keyboard or gamepad; let go and it stops."""

import argparse
import contextlib
import os
import shutil
import signal
import sys
from typing import Any


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("--robot", default="robot", metavar="NAME", help="which robot (default robot)")
    parser.add_argument("--domain", type=int, default=0, help="ROS domain (default 0)")
    parser.add_argument("--name", default="", help="who you are, for others (default user@machine/process)")
    parser.add_argument(
        "--stick", choices=("any", "keyboard", "gamepad"), default="any", help="what to steer with"
    )
    parser.add_argument("--speed", type=float, default=0.3, metavar="M/S", help="highest speed (default 0.3)")
    parser.add_argument(
        "--turn", type=float, default=1.2, metavar="RAD/S", help="highest turn rate (default 1.2)"
    )


def run(args: argparse.Namespace) -> int:
    """Drive until Ctrl-C."""
    from runtime import gate
    from runtime.bus import Bus
    from runtime.clock import Clock
    from runtime.errors import ConfigError
    from runtime.node import BusPort
    from runtime.nodes import teleop

    try:
        config = teleop.Config(speed_mps=args.speed, turn_rate_radps=args.turn, name=args.name)
    except ValueError as error:
        raise ConfigError(f"hallway teleop: {error}") from error
    where = gate.visit(args.robot)

    def open_bus() -> Bus:
        from runtime.bus_zenoh import ZenohBus

        return ZenohBus(where)

    port = BusPort(
        "teleop",
        open_bus,
        subscribes=teleop.SUBSCRIBES,
        publishes=teleop.PUBLISHES,
        robot=args.robot,
        domain=args.domain,
        clock=Clock(),
    )
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        signal.signal(number, lambda *_: port.stop())
    return _drive(port, config, args.stick)


def _drive(port: Any, config: Any, kind: str) -> int:
    from runtime.errors import ConfigError
    from runtime.nodes import gamepad, keyboard, teleop

    terminal = sys.stdin.fileno()

    def keys() -> keyboard.Keyboard:
        if not os.isatty(terminal):
            raise ConfigError("the keyboard needs a terminal, standard input is none; try --stick gamepad")
        return keyboard.Keyboard(terminal, port.clock)

    stick = teleop.choose_stick(kind, port.clock, keys)
    by_keys = isinstance(stick, keyboard.Keyboard)
    try:
        with keyboard.raw(terminal) if by_keys else contextlib.nullcontext(), port:
            print(keyboard.HELP if by_keys else gamepad.HELP)
            return teleop.steer(port, config, stick, _Painter().show)
    finally:
        stick.close()


class _Painter:
    """Keeps a few lines at the foot of the terminal up to date; without a terminal it says what changes."""

    def __init__(self) -> None:
        self._painted = 0
        self._said = ""
        self._terminal = sys.stdout.isatty()

    def show(self, view: Any) -> None:
        """Paint what there is to see."""
        if not self._terminal:
            if (line := view.robot_line()) != self._said:
                self._said = line
                print(line, flush=True)
            return
        width = shutil.get_terminal_size().columns - 1
        lines = [line[:width] for line in view.lines()]
        back = f"\x1b[{self._painted}A" if self._painted else ""
        sys.stdout.write(back + "".join(f"\r\x1b[K{line}\n" for line in lines))
        sys.stdout.flush()
        self._painted = len(lines)
