"""Drive a robot by keyboard or gamepad; let go and it stops."""

import argparse
import contextlib
import os
import shutil
import signal
import sys
from pathlib import Path
from typing import Any

from runtime.cli.which_robot import add_robot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    add_robot(parser, domain=True)
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
    from runtime.access import gate
    from runtime.errors import ConfigError
    from runtime.nodes import teleop

    try:
        config = teleop.Config(speed_mps=args.speed, turn_rate_radps=args.turn, name=args.name)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    gate.visit(args.robot)  # where there is no such robot, say so before anything else
    desk = _Desk(args, config)
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        signal.signal(number, lambda *_: desk.stop())
    return desk.drive()


class _Desk:
    """Somebody at a stick: one link to the robot after the other, until the person leaves."""

    def __init__(self, args: argparse.Namespace, config: Any) -> None:
        from runtime.clock import Clock

        self._args, self._config = args, config
        self._clock = Clock()
        self._port: Any = None
        self._bus: Any = None
        self._asking: Any = None
        self._painter = _Painter()
        self._leaving = False

    def stop(self) -> None:
        """Leave soon; called by a signal."""
        self._leaving = True
        if self._port is not None:
            self._port.stop()

    def drive(self) -> int:
        """Steer; connect again when the link was lost."""
        from runtime.errors import HallwayError
        from runtime.nodes import gamepad, keyboard, teleop

        stick = teleop.choose_stick(self._args.stick, self._clock, self._keyboard)
        by_keys = isinstance(stick, keyboard.Keyboard)
        raw = keyboard.raw(sys.stdin.fileno()) if by_keys else contextlib.nullcontext()
        with contextlib.closing(stick), raw:
            print(keyboard.HELP if by_keys else gamepad.HELP)
            connected = False
            while not self._leaving:
                try:
                    with self._link() as self._port:
                        connected = True
                        if self._steer(stick) is teleop.End.LEFT:
                            return 0
                except HallwayError as error:
                    if not connected:
                        raise
                    self._painter.say(f"no link: {error}")
                finally:
                    if self._asking is not None:
                        self._asking.join()  # the bus is closed, and a closed bus is not waited for
                self._leaving |= any(wish.leave for wish in stick.poll(0.5))
        return 0

    def _steer(self, stick: Any) -> Any:
        from runtime.nodes import teleop

        return teleop.steer(self._port, self._config, stick, self._painter.show, self._keep)

    def _keep(self) -> None:
        """Have the last minutes kept on the robot; in a thread, for the stick waits for no answer."""
        import threading

        if self._asking is None or not self._asking.is_alive():
            self._asking = threading.Thread(target=self._ask_to_keep, daemon=True)
            self._asking.start()

    def _ask_to_keep(self) -> None:
        from runtime.nodes.keeping import ask_to_keep

        folders = ask_to_keep(self._bus, self._args.robot)
        kept = f"the last minutes are kept on the robot: {', '.join(Path(one).name for one in folders)}"
        self._painter.note = kept if folders else "nothing was kept: no recorder of this robot has a ring"

    def _keyboard(self) -> Any:
        from runtime.errors import ConfigError
        from runtime.nodes.keyboard import Keyboard

        terminal = sys.stdin.fileno()
        if not os.isatty(terminal):
            raise ConfigError("the keyboard needs a terminal, standard input is none; try --stick gamepad")
        return Keyboard(terminal, self._clock)

    def _link(self) -> Any:
        from runtime.access import gate
        from runtime.bus.zenoh_bus import ZenohBus
        from runtime.nodes import teleop
        from runtime.process.node import BusPort

        self._bus = ZenohBus(gate.visit(self._args.robot))
        return BusPort(
            "teleop",
            lambda: self._bus,
            subscribes=teleop.SUBSCRIBES,
            publishes=teleop.PUBLISHES,
            robot=self._args.robot,
            domain=self._args.domain,
            clock=self._clock,
        )


class _Painter:
    """Keeps a few lines at the foot of the terminal up to date; without a terminal it says what changes."""

    def __init__(self) -> None:
        self.note = ""
        """Something that happened, for the line below the others."""
        self._painted = 0
        self._said = ""
        self._terminal = sys.stdout.isatty()

    def show(self, view: Any) -> None:
        """Paint what there is to see."""
        if not self._terminal:
            self.say("; ".join(filter(None, (view.robot_line(), self.note))))
            return
        self._said = ""
        width = shutil.get_terminal_size().columns - 1
        lines = [line[:width] for line in (*view.lines(), self.note)]
        back = f"\x1b[{self._painted}A" if self._painted else ""
        sys.stdout.write(back + "".join(f"\r\x1b[K{line}\n" for line in lines))
        sys.stdout.flush()
        self._painted = len(lines)

    def say(self, line: str) -> None:
        """Say something that happened, once as long as it stays the same."""
        if line != self._said:
            self._said = line
            self._painted = 0
            print(line, flush=True)
