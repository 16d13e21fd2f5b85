"""Look at a robot or a recording: map, scan, path, states.

The robot may run here, or elsewhere if this machine was paired with it.
"""

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.cli.parsing import read_address
from runtime.cli.stopping import asked_to_stop, insisting
from runtime.cli.which_robot import add_robot
from runtime.errors import ConfigError

if TYPE_CHECKING:
    from runtime.nodes.viewer import Config
    from runtime.nodes.viewing.recording import Shown

_TURN_S = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument(
        "file",
        type=Path,
        nargs="?",
        help="recording (.mcap or .rrd), session or results folder; else a running robot",
    )
    add_robot(parser, domain=True)
    parser.add_argument(
        "--connect",
        type=read_address,
        metavar="HOST[:PORT]",
        help="where the paired robot is now, if it has moved",
    )
    parser.add_argument("--web", action="store_true", help="as a page at 127.0.0.1 instead of a window")
    parser.add_argument("--save", type=Path, metavar="F.rrd", help="into a file instead of a window")
    parser.add_argument("--port", type=int, default=9876, metavar="N", help="of the picture (default 9876)")
    parser.add_argument("--web-port", type=int, default=9090, metavar="N", help="of the page (default 9090)")
    parser.add_argument(
        "--memory",
        type=int,
        default=512,
        metavar="MB",
        help="of the picture; the oldest goes first (default 512)",
    )


def run(args: argparse.Namespace) -> int:
    """Show until the window is closed, the robot ends (0) or Ctrl-C (130)."""
    from runtime.nodes import viewer
    from runtime.reports.results import check_writable

    if args.web and args.save:
        raise ConfigError("--web and --save: choose one")
    if args.save is not None and args.save.exists():
        raise ConfigError(f"--save {args.save}: exists already")
    if args.save is not None:
        if args.save.suffix != ".rrd":
            raise ConfigError(f"--save {args.save}: must end in .rrd, to be opened again")
        check_writable(args.save)
        args.save.parent.mkdir(parents=True, exist_ok=True)
    try:
        config = viewer.Config(
            mode="web" if args.web else "save" if args.save else "auto",
            file=str(args.save or ""),
            port=args.port,
            web_port=args.web_port,
            memory_mb=args.memory,
        )
    except ValueError as error:
        raise ConfigError(str(error)) from error
    with tempfile.TemporaryDirectory(prefix="hallway-view-") as folder, asked_to_stop(insisting(3)) as asked:
        if args.file is None:
            code = _show_robot(args, config, Path(folder), asked)
        elif args.file.suffix == ".rrd":
            code = _show_rrd(args.file, config, Path(folder), asked)
        else:
            code = _show_recording(args, config, Path(folder), asked)
    return 130 if signal.SIGINT in asked else code


def _show_robot(args: argparse.Namespace, config: "Config", folder: Path, asked: list[int]) -> int:
    from runtime import rundir
    from runtime.access import gate
    from runtime.bus.offset import Follower
    from runtime.bus.zenoh_bus import ZenohBus
    from runtime.clock import Clock
    from runtime.nodes import viewer
    from runtime.nodes.viewing.scene import SUBSCRIBES
    from runtime.process.node import BusPort

    session = _session(args.robot, args.connect)
    presence = rundir.Presence(args.robot)

    class RobotPort(BusPort):
        """Stops with the person who looks, and with the robot."""

        @property
        def stopping(self) -> bool:
            if asked or (args.connect is None and presence.gone):
                self.stop()
            return super().stopping

    clock = Clock()
    followers: list[Follower] = []

    def open_bus() -> ZenohBus:
        bus = ZenohBus(session)
        followers.append(Follower(bus, args.robot, clock))
        return bus

    port = RobotPort(
        f"view_{os.getpid()}",
        open_bus,
        clock=clock,
        guest=gate.is_guest(session),
        subscribes=SUBSCRIBES,
        robot=args.robot,
        domain=args.domain,
        run_dir=folder,
    )
    try:
        with port:
            return viewer.run(port, config, say=_say)
    finally:
        for follower in followers:
            follower.close()


def _session(robot: str, address: str | None) -> dict[str, Any]:
    """Return how to reach a robot: on this machine, or paired with it, perhaps at another address."""
    from dataclasses import replace

    from runtime.access import gate
    from runtime.access.keys import paired

    if address is None:
        return gate.visit(robot)
    invitation = paired(robot)
    if invitation is None:
        raise ConfigError(f"--connect {address}: this machine is not paired with {robot!r}; see hallway keys")
    port = invitation.address.rpartition(":")[2]
    return gate.guest(replace(invitation, address=address if ":" in address else f"{address}:{port}"))


def _show_recording(args: argparse.Namespace, config: "Config", folder: Path, asked: list[int]) -> int:
    from runtime.nodes.viewing.recording import draw, shown

    content = shown(args.file)
    with _target(config, folder, content) as (screen, server):
        drawn = draw(content, screen, lambda: bool(asked))
        print(f"{args.file}: {drawn} messages of {content.name!r}", file=sys.stderr)
        if server is None:
            screen.close(60.0)
            print(f"saved to {config.file}", file=sys.stderr)
            return 0
        screen.close(10.0)
        _say(server.page or "a window")
        return _wait(server, asked)


def _show_rrd(file: Path, config: "Config", folder: Path, asked: list[int]) -> int:
    from runtime.nodes.viewing.screen import send_file

    if config.mode == "save":
        raise ConfigError(f"--save {config.file}: {file} is saved already")
    if not file.is_file():
        raise FileNotFoundError(2, "No such file or directory", str(file))
    with _server(config, folder) as server:
        send_file(server.url, file)
        _say(server.page or "a window")
        return _wait(server, asked)


@contextmanager
def _target(config: "Config", folder: Path, content: "Shown") -> Iterator[tuple[Any, Any]]:
    from runtime.nodes.viewing.screen import Screen

    told = not content.words
    if config.mode == "save":
        yield Screen(content.name, file=Path(config.file), told=told), None
        return
    with _server(config, folder) as server:
        yield Screen(content.name, url=server.url, told=told), server


@contextmanager
def _server(config: "Config", folder: Path) -> Iterator[Any]:
    from runtime.graph import has_screen
    from runtime.nodes.viewing.server import ViewerServer

    server = ViewerServer(
        web=config.mode == "web" or not has_screen(),
        port=config.port,
        web_port=config.web_port,
        memory_mb=config.memory_mb,
        log=folder / "viewer.log",
    )
    try:
        yield server
    finally:
        server.close()


def _wait(server: Any, asked: list[int]) -> int:
    while not asked and server.exit_code is None:
        time.sleep(_TURN_S)
    return 0 if asked or server.exit_code == 0 else 1


def _say(where: str) -> None:
    if "://" in where:
        print(f"look at this page, Ctrl-C ends:\n{where}", flush=True)  # alone on its line, to be clicked
    else:
        verb = "saving to" if where.endswith(".rrd") else "showing in"
        print(f"{verb} {where}; Ctrl-C ends", flush=True)
