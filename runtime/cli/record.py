"""Record the topics of a running robot to MCAP files.

What was said up to the last second is in them, whatever happens.
"""

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from runtime.cli.for_machines import print_json
from runtime.cli.parsing import number
from runtime.cli.patience import told
from runtime.cli.stopping import asked_to_stop
from runtime.cli.which_robot import DOMAIN, add_robot
from runtime.errors import ConfigError, DataLostError

KEEP_WAIT_S = 90.0
"""How long the newest file of a ring is waited for; the files of a ring of 15 minutes are that long."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    add_robot(parser)
    parser.add_argument("--domain", type=DOMAIN, metavar="N", help="ROS domain (default the robot's)")
    parser.add_argument("--out", type=Path, metavar="F.mcap", help="default recordings/NAME-TIME.mcap")
    parser.add_argument("--topics", nargs="+", default=[], metavar="T", help="which topics (default all)")
    parser.add_argument(
        "--duration", type=number(least=0.0), default=0.0, metavar="S", help="end after S seconds"
    )
    parser.add_argument("--split-mb", type=float, default=0.0, metavar="MB", help="new file after so much")
    parser.add_argument("--split-s", type=float, default=0.0, metavar="S", help="new file after so long")
    parser.add_argument(
        "--ring", type=float, default=0.0, metavar="S", help="keep only the last S seconds, in a folder"
    )
    parser.add_argument(
        "--keep", action="store_true", help="keep what is in the robot's ring now, in the folder --out"
    )
    parser.add_argument("--json", action="store_true", help="machine-readable, one object at the end")


def run(args: argparse.Namespace) -> int:
    """Record until Ctrl-C (130), the duration or the robot's end (0); 4 if anything was lost."""
    name = f"{args.robot}-{time.strftime('%Y%m%d-%H%M%S')}"
    if args.keep:
        return _keep(args, args.out or Path("recordings") / name)
    out = args.out or Path("recordings") / f"{name}.mcap"
    config = _config(args, out)
    from runtime import rundir
    from runtime.access import gate
    from runtime.bus.zenoh_bus import ZenohBus
    from runtime.nodes.recorder import path_of
    from runtime.recordings.recovery import recover_cut

    session = gate.visit(args.robot)
    for line in recover_cut(path_of(config, out.parent)):
        if not args.json:
            print(line, file=sys.stderr)
    if args.ring:
        rundir.private(args.robot)
    with ZenohBus(session) as bus:
        return _record(args, config, bus, gate.is_guest(session))


def _record(args: argparse.Namespace, config: Any, bus: Any, guest: bool) -> int:
    from runtime import rundir
    from runtime.clock import Clock
    from runtime.nodes import recorder
    from runtime.process.node import BusPort

    identity, about = _run_of(args.robot, bus, guest)
    if args.domain is not None:
        identity = replace(identity, domain=args.domain)
    port = BusPort(
        f"record_{os.getpid()}",
        lambda: bus,
        guest=guest,
        subscribes=recorder.SUBSCRIBES,
        robot=args.robot,
        domain=identity.domain,
        # On the robot's own machine, arrival and publication are read from one clock.
        clock=Clock(None if guest else identity.clock_offset_ns),
        run_dir=rundir.run_dir(args.robot),
    )
    presence = rundir.Presence(args.robot)

    def turn(recording: Any) -> None:
        if presence.gone or recording.stopped:
            port.stop()
        if not args.json and time.monotonic() - said[0] > 5.0:
            said[0] = time.monotonic()
            _say(recording, lacks_scans(config, recording))

    said = [time.monotonic()]
    with asked_to_stop(lambda asked: port.stop()) as interrupted, port:
        recording = recorder.record(port, config, turn, identity, about)
    where = f"robot {args.robot!r} in ROS domain {identity.domain}"
    return _report(recording, lacks_scans(config, recording), where, args.json) or (130 if interrupted else 0)


def _report(recording: Any, lacking: bool, where: str, as_json: bool) -> int:
    """Say what came of it; 4 if anything was lost."""
    counts = recording.counts
    report = {"files": [str(path) for path in recording.files], "written": counts.written}
    report |= {"lost": counts.total_lost, "stopped": recording.stopped}
    print_json(report) if as_json else _say(recording, lacking)
    if lacking:
        print(f"hallway record: no scan came from {where}; does its laser run?", file=sys.stderr)
    return int(DataLostError.exit_code) if counts.total_lost or recording.stopped else 0


def _run_of(robot: str, bus: Any, guest: bool) -> tuple[Any, dict[str, str]]:
    """Return what is known of the run that is recorded, and of its clock where that is not ours."""
    from runtime import rundir
    from runtime.bus.offset import measured
    from runtime.clock import Clock
    from runtime.process import identity

    if not guest:
        return identity.left_in(rundir.run_dir(robot)), {}
    offset = measured(bus, robot, Clock())
    ahead, error = ("unknown", "unknown") if offset is None else (offset.offset_ns, offset.round_trip_ns // 2)
    about = {"robot.clock_ahead_ns": str(ahead), "robot.clock_ahead_error_ns": str(error)}
    return identity.told(bus.ask, robot), about


def _config(args: argparse.Namespace, out: Path) -> Any:
    from runtime.nodes.recorder import Config
    from runtime.recordings.recording import RecordingConfig

    try:
        recording = RecordingConfig(split_mb=args.split_mb, split_s=args.split_s, ring_s=args.ring)
        topics = tuple(name.strip("/") for name in args.topics)
        return Config(file=str(out), topics=topics, duration_s=args.duration, recording=recording)
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _keep(args: argparse.Namespace, folder: Path) -> int:
    """Keep the ring of the robot that runs here; 0 when something was in it."""
    from runtime import rundir
    from runtime.nodes.recorder import RING
    from runtime.recordings.recovery import keep_ring

    ring = rundir.run_dir(args.robot) / RING
    if not ring.is_symlink() and not rundir.is_running(args.robot):
        return _keep_there(args)
    if not ring.is_symlink():
        raise ConfigError(
            f"robot {args.robot!r} keeps no ring here; start one with `hallway record --ring 300`"
        )
    if folder.exists():
        raise ConfigError(f"{folder}: exists already; choose another folder with --out")
    with told(
        _tell, f"the newest part is still written; it is kept when it is whole, in {KEEP_WAIT_S:g} s at most"
    ):
        files = keep_ring(ring.readlink(), folder, within_s=KEEP_WAIT_S)
    report = {"folder": str(folder), "files": [path.name for path in files]}
    print_json(report) if args.json else print(f"{folder}/: {', '.join(report['files']) or 'nothing'}")
    return 0 if files else 1


def _tell(line: str) -> None:
    print(f"hallway record: {line}", file=sys.stderr, flush=True)


def _keep_there(args: argparse.Namespace) -> int:
    """Have the rings of a robot kept on its own machine; 0 when there was one."""
    from runtime.access import gate
    from runtime.bus.zenoh_bus import ZenohBus
    from runtime.nodes.keeping import ask_to_keep

    with ZenohBus(gate.visit(args.robot)) as bus:
        folders = ask_to_keep(bus, args.robot)
    report = {"folders_there": folders}
    print_json(report) if args.json else print(f"on the robot: {', '.join(folders) or 'no ring'}")
    return 0 if folders else 1


def lacks_scans(config: Any, recording: Any) -> bool:
    """Whether scans should be in a recording, and none has come so far."""
    return "scan" in (config.topics or ("scan",)) and "scan" not in recording.topics


def _say(recording: Any, lacking: bool) -> None:
    counts = recording.counts
    text = f"{counts.written} messages in {', '.join(map(str, recording.files)) or 'no file'}"
    if counts.total_lost:
        text += f"; {counts.words()}"
    if lacking:
        text += "; no scan so far"
    if recording.stopped:
        text += f"; nothing more is recorded: {recording.stopped}"
    print(text, file=sys.stderr, flush=True)
