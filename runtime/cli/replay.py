"""Play a recording onto the bus, as a robot of its own.

At its own pace, another, or message by message.
"""

import argparse
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.cli.fitting import fitted
from runtime.cli.for_machines import print_json
from runtime.cli.parsing import number
from runtime.cli.replay_keys import HELP, Keys
from runtime.cli.stopping import asked_to_stop
from runtime.cli.which_robot import DOMAIN
from runtime.errors import ConfigError, DataLostError

if TYPE_CHECKING:
    from runtime.bus.contract import Bus
    from runtime.clock import Clock
    from runtime.recordings.pace import Control
    from runtime.recordings.replay import Played, Recorded, ReplayConfig

SECONDS = number(least=0.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="MCAP recording, or its parts")
    parser.add_argument("--rate", type=float, default=1.0, help="times the speed; 0 as fast as it goes")
    parser.add_argument(
        "--start", type=SECONDS, default=0.0, metavar="S", help="leave out the first S seconds"
    )
    parser.add_argument("--duration", type=SECONDS, default=0.0, metavar="S", help="play S recorded seconds")
    parser.add_argument("--loop", action="store_true", help="begin again at the end")
    parser.add_argument(
        "--topics", nargs="+", default=[], metavar="T", help="which topics (default all but cmd_vel)"
    )
    parser.add_argument("--as", dest="robot", metavar="NAME", help="name of the robot (default as recorded)")
    parser.add_argument(
        "--domain", type=DOMAIN, metavar="N", help="ROS domain (default that of the robot if it runs, else 0)"
    )
    parser.add_argument("--wait", action="store_true", help="begin when somebody listens")
    parser.add_argument("--paused", action="store_true", help=f"start paused; keys: {HELP}")
    parser.add_argument(
        "--map", action="store_true", help="through the live matcher and mapper, to a results folder"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="results folder of --map")
    parser.add_argument("--json", action="store_true", help="machine-readable, one object at the end")


def run(args: argparse.Namespace) -> int:
    """Play; 0 at the end, 130 after Ctrl-C or q, 4 when something was missing from what was played."""
    from runtime.graph import check_robot
    from runtime.recordings.replay import Recorded, ReplayConfig

    try:
        config = ReplayConfig(
            rate=args.rate,
            start_s=args.start,
            duration_s=args.duration,
            loop=args.loop,
            topics=tuple(name.strip("/") for name in args.topics),
        )
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if args.map:
        from runtime.cli.replay_map import map_live

        return map_live(args, config)
    if args.out is not None:
        raise ConfigError("--out: only with --map")
    recorded = Recorded(args.files, config)
    robot = (
        args.robot if args.robot is not None else recorded.metadata.get("hallway", {}).get("robot", "robot")
    )
    check_robot(robot, "--as")
    if not args.json:
        said = ", ".join(recorded.played)
        line = f"{recorded.duration_s:.1f} s of {said} as robot {robot!r}"
        print(fitted(line, stream=sys.stderr), file=sys.stderr)
    with _stage(robot, recorded, args.domain) as stage:
        played = _play(stage, robot, recorded, config, args)
    return _report(played, recorded, args)


@dataclass(frozen=True, slots=True)
class _Stage:
    """Where a recording is played."""

    bus: "Bus"
    domain: int
    clock: "Clock"
    """Of the robot that is played, or that runs here already."""


@contextmanager
def _stage(robot: str, recorded: "Recorded", domain: int | None) -> Iterator[_Stage]:
    """Open the bus of a robot of that name: join the one that runs, or be its hub."""
    from runtime import messages, rundir
    from runtime.bus import links
    from runtime.bus.zenoh_bus import ZenohBus
    from runtime.clock import Clock
    from runtime.process.identity import CONFIG_FILE, Identity, left_in

    if not rundir.is_running(robot):
        clock = Clock.from_environment()
        with rundir.claimed(robot) as run_dir:
            # Whoever records the replay shall know the run as it was, and the domain in which it is played.
            Identity(recorded.seed, domain or 0, clock.offset_ns).leave(run_dir)
            if config := recorded.attachments.get(CONFIG_FILE):
                (run_dir / CONFIG_FILE).write_bytes(config)
            with ZenohBus(links.hub(run_dir)) as bus:
                yield _Stage(bus, domain or 0, clock)
        return
    run_dir = rundir.running(robot)
    here = left_in(run_dir)
    domain = here.domain if domain is None else domain
    with ZenohBus(links.visitor(run_dir)) as bus:
        endpoints = messages.endpoints_of(bus.tokens(f"@ros2_lv/{domain}/**"))
        spoken = {e.topic.strip("/") for e in endpoints if e.kind == "MP"}
        for name in recorded.played:
            if f"{robot}/{name}" in spoken:
                rule = f"robot {robot!r} runs and publishes {name} itself"
                raise ConfigError(f"{rule}; play as another with --as, or fewer --topics")
        yield _Stage(bus, domain, Clock(here.clock_offset_ns))


def _play(
    stage: _Stage, robot: str, recorded: "Recorded", config: "ReplayConfig", args: argparse.Namespace
) -> "Played":

    from runtime.messages import Clock, time_of
    from runtime.process.node import BusPort
    from runtime.recordings.pace import Control
    from runtime.recordings.replay import in_name_of, play

    name = f"player_{os.getpid()}"
    port = BusPort(
        name,
        lambda: stage.bus,
        publishes=(*recorded.played, "clock"),
        robot=robot,
        domain=stage.domain,
        clock=stage.clock,
    )
    control = Control(paused=args.paused, stopping=lambda: port.stopping)
    screen = _Screen(recorded, control, args.json)

    def publish(topic: str, payload: bytes, publisher: str, skipped: int) -> None:
        ours = in_name_of(robot, payload) if topic == "diagnostics" else payload
        port.publish_raw(topic, ours, publisher, skipped)

    def publish_clock(now_ns: int) -> None:
        port.publish("clock", Clock(clock=time_of(now_ns)))
        screen.show(now_ns)

    def sleep(seconds: float) -> None:
        if not keys.poll(control, seconds):
            port.stop()

    try:
        with asked_to_stop(lambda asked: port.stop()), Keys() as keys, port:
            port.ready()
            if args.wait:
                _wait_for_listener(stage, robot, recorded, port)
            return play(recorded, config, control, publish, publish_clock, sleep=sleep)
    finally:
        screen.clear()


def _wait_for_listener(stage: _Stage, robot: str, recorded: "Recorded", port: Any) -> None:
    from runtime import messages

    wanted = {f"{robot}/{name}" for name in recorded.played}
    while not port.stopping:
        endpoints = messages.endpoints_of(stage.bus.tokens(f"@ros2_lv/{stage.domain}/**"))
        if wanted & {e.topic.strip("/") for e in endpoints if e.kind == "MS"}:
            return
        time.sleep(0.1)


def _report(played: "Played", recorded: "Recorded", args: argparse.Namespace) -> int:
    from runtime.cli.gaps import print_gaps

    late_ms = played.worst_late_ns / 1e6
    report: dict[str, Any] = {"sent": played.messages, "worst_late_ms": round(late_ms, 3)}
    report |= {"gaps": recorded.gaps(), "outages": recorded.outages(), "losses": recorded.losses()}
    if args.json:
        print_json(report)
    else:
        sent = ", ".join(f"{count} {name}" for name, count in played.messages.items()) or "nothing"
        print(fitted(f"sent {sent}; at most {late_ms:.1f} ms late"))
        print_gaps("not in the recording", report["gaps"])
        for one in report["outages"] + report["losses"]:
            print(f"hallway replay: {one}", file=sys.stderr)
    if not played.complete:
        return 130
    return int(DataLostError.exit_code) if report["losses"] else 0


class _Screen:
    """One line that says where the recording is."""

    def __init__(self, recorded: "Recorded", control: "Control", quiet: bool) -> None:
        self._recorded, self._control = recorded, control
        self._terminal = sys.stderr.isatty()
        self._quiet = quiet
        self._said_s = 0.0
        if self._terminal and not quiet:
            print(HELP, file=sys.stderr)

    def clear(self) -> None:
        """Make room for what is said at the end."""
        if self._terminal and not self._quiet:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

    def show(self, now_ns: int) -> None:
        """Say the recorded time."""
        now_s = time.monotonic()
        if self._quiet or now_s - self._said_s < (0.2 if self._terminal else 5.0):
            return
        self._said_s = now_s
        at_s = (now_ns - self._recorded.began_ns) / 1e9
        state = "paused" if self._control.paused else f"{self._control.rate:g} x"
        text = f"{at_s:8.1f} of {self._recorded.duration_s:.1f} s, {state}"
        print(f"\r\x1b[K{text}" if self._terminal else text, end="" if self._terminal else "\n",
              file=sys.stderr, flush=True)  # fmt: skip
