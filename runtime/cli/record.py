"""Record the topics of a running robot to MCAP files, up to the last second whatever happens."""

import argparse
import json
import os
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

from runtime.errors import ConfigError, DataLostError

KEEP_WAIT_S = 90.0
"""How long the newest file of a ring is waited for; the files of a ring of 15 minutes are that long."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("--robot", default="robot", metavar="NAME", help="which robot (default robot)")
    parser.add_argument("--out", type=Path, metavar="F.mcap", help="default recordings/NAME-TIME.mcap")
    parser.add_argument("--topics", nargs="+", default=[], metavar="T", help="which topics (default all)")
    parser.add_argument("--duration", type=float, default=0.0, metavar="S", help="end after S seconds")
    parser.add_argument("--split-mb", type=float, default=0.0, metavar="MB", help="new file after so much")
    parser.add_argument("--split-s", type=float, default=0.0, metavar="S", help="new file after so long")
    parser.add_argument("--ring", type=float, default=0.0, metavar="S", help="keep only the last S seconds")
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
    from runtime import gate, rundir
    from runtime.bus_zenoh import ZenohBus
    from runtime.node import BusPort
    from runtime.nodes import recorder

    session = gate.visit(args.robot)
    _recover(out, args.json)
    port = BusPort(
        f"record_{os.getpid()}",
        lambda: ZenohBus(session),
        guest=gate.is_guest(session),
        subscribes=recorder.SUBSCRIBES,
        robot=args.robot,
        run_dir=rundir.run_dir(args.robot),
    )
    presence = rundir.Presence(args.robot)
    interrupted: list[int] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        interrupted.append(number)
        port.stop()

    def turn(recording: Any) -> None:
        if presence.gone:
            port.stop()
        if not args.json and time.monotonic() - said[0] > 5.0:
            said[0] = time.monotonic()
            _say(recording)

    said = [time.monotonic()]
    before = {n: signal.signal(n, on_signal) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        with port:
            recording = recorder.record(port, config, turn)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    counts = recording.counts
    report = {"files": [str(path) for path in recording.files], "written": counts.written}
    report |= {"lost": counts.total_lost, "disk_full": recording.full}
    print(json.dumps(report)) if args.json else _say(recording)
    if counts.total_lost or recording.full:
        return int(DataLostError.exit_code)
    return 130 if interrupted else 0


def _config(args: argparse.Namespace, out: Path) -> Any:
    from runtime.nodes.recorder import Config
    from runtime.recording import RecordingConfig

    try:
        recording = RecordingConfig(split_mb=args.split_mb, split_s=args.split_s, ring_s=args.ring)
        topics = tuple(name.strip("/") for name in args.topics)
        return Config(file=str(out), topics=topics, duration_s=args.duration, recording=recording)
    except ValueError as error:
        raise ConfigError(f"hallway record: {error}") from error


def _keep(args: argparse.Namespace, folder: Path) -> int:
    """Keep the ring of the robot that runs here; 0 when something was in it."""
    from runtime import rundir
    from runtime.nodes.recorder import RING
    from runtime.recovery import keep_ring

    ring = rundir.running(args.robot) / RING
    if not ring.is_dir():
        raise ConfigError(
            f"robot {args.robot!r} keeps no ring here; start one with `hallway record --ring 300`"
        )
    if folder.exists():
        raise ConfigError(f"{folder}: exists already; choose another folder with --out")
    files = keep_ring(ring, folder, within_s=KEEP_WAIT_S)
    report = {"folder": str(folder), "files": [path.name for path in files]}
    print(json.dumps(report) if args.json else f"{folder}/: {', '.join(report['files']) or 'nothing'}")
    return 0 if files else 1


def _recover(out: Path, quiet: bool) -> None:
    """Make whole files of those that an earlier recording of this name left unfinished."""
    from runtime.recovery import salvage

    for cut in sorted(out.parent.glob(f"{out.stem}*.mcap.active")) if out.parent.is_dir() else []:
        whole = cut.with_name(cut.name.removesuffix(".active"))
        if whole.exists():
            continue
        _, count, _ = salvage(cut)
        cut.unlink()
        if not quiet:
            print(f"{whole}: {count} messages recovered from a recording that was cut", file=sys.stderr)


def _say(recording: Any) -> None:
    counts = recording.counts
    text = f"{counts.written} messages in {', '.join(map(str, recording.files)) or 'no file'}"
    if counts.total_lost:
        text += f"; {counts.total_lost} LOST"
    if recording.full:
        text += "; the disk is full, nothing more is recorded"
    print(text, file=sys.stderr, flush=True)
