"""Turn a log, recording or trajectory into another format.

A recording that was cut becomes a whole one.
"""

import argparse
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.cli.for_machines import print_json
from runtime.errors import ConfigError, DataLostError

if TYPE_CHECKING:
    from runtime.formats.laser_log import LaserLog

KINDS = {
    ".clf": "carmen",
    ".log": "carmen",
    ".dat": "tinyslam",
    ".mcap": "mcap",
    ".bag": "ros1",
    ".tum": "tum",
}
"""What a target is by its name; a name without a suffix is the folder of a ROS 2 bag."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("source", type=Path, help="a laser log, bag, recording (also cut), or TUM file")
    parser.add_argument(
        "target", type=Path, help="X.clf, X.dat, X.mcap, X.bag (ROS 1), X.tum, or a new folder (ROS 2 bag)"
    )
    parser.add_argument("--topic", metavar="T", help="which laser, or which poses for X.tum")
    parser.add_argument("--json", action="store_true", help="machine-readable, one object")


def run(args: argparse.Namespace) -> int:
    """Convert; 0 when done, 4 when the source itself had holes. What the target cannot hold is told."""
    from runtime.reports.results import check_writable

    source, target = args.source, args.target
    kind = KINDS.get(target.suffix) if target.suffix else "ros2"
    if kind is None:
        raise ConfigError(f"{target}: suffix {target.suffix!r}, must be one of {', '.join(KINDS)} or none")
    if target.exists():
        raise ConfigError(f"{target}: exists already; choose another name")
    if not target.parent.is_dir():
        raise ConfigError(f"{target}: its folder {target.parent} does not exist")
    check_writable(target)
    if not source.exists():
        raise FileNotFoundError(2, "No such file or directory", str(source))
    unfinished = target.with_name(f".{target.name}.partial")
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        unfinished.mkdir()
        # Under its own name: a ROS 2 bag calls the file in it after itself.
        partial = unfinished / target.name
        report = _convert(source, partial, kind, args.topic)
        partial.rename(target)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    report = {"source": str(source), "target": str(target), "kind": kind, **report}
    if args.json:
        print_json(report)
    else:
        print(f"{target}: {report['messages']} {report['what']}")
        for one in report["not_held"]:
            print(f"hallway convert: {target.name} cannot hold {one}", file=sys.stderr)
        for one in report["losses"]:
            print(f"hallway convert: {one}", file=sys.stderr)
    return int(DataLostError.exit_code) if report["losses"] else 0


def _convert(source: Path, partial: Path, kind: str, topic: str | None) -> dict[str, Any]:
    from runtime.formats.mcap_log import is_mcap

    if _is_trajectory(source):
        return _from_trajectory(source, partial, kind)
    if kind == "tum":
        return _to_trajectory(source, partial, topic)
    if is_mcap(source) and topic is None and kind in ("mcap", "ros1", "ros2"):
        return _from_recording(source, partial, kind)
    from runtime.formats.logs import open_log

    log = open_log(source, topic)
    not_held = _LOG_WRITERS[kind](partial, log)
    return {"messages": len(log), "what": "scans", "not_held": not_held, "losses": list(log.losses)}


def _from_recording(source: Path, partial: Path, kind: str) -> dict[str, Any]:
    from runtime.formats import write_bags
    from runtime.formats.mcap_log import McapReader
    from runtime.formats.missing import account_of
    from runtime.recordings.recovery import salvage

    reader = McapReader(source)
    not_held: list[str] = []
    if kind == "mcap":
        count = salvage(source, partial)[1]
    elif kind == "ros2":
        count = write_bags.write_ros2(partial, reader.messages())
        not_held = ["the publishers' sequence numbers", "metadata and configuration of the run"]
    else:
        count, left_out = write_bags.write_ros1(partial, reader.messages())
        not_held = [f"{n} messages of {topic}: only laser scans go there" for topic, n in left_out.items()]
    losses = [f"{source}: {one}" for one in account_of(source).losses()]
    return {"messages": count, "what": "messages", "not_held": not_held, "losses": losses}


def _from_trajectory(source: Path, partial: Path, kind: str) -> dict[str, Any]:
    from runtime.formats import write_bags
    from runtime.formats.tum import read_tum, write_tum

    trajectory = read_tum(source)
    messages = write_bags.pose_messages(trajectory)
    if kind == "mcap":
        write_bags.write_mcap(partial, messages)
    elif kind == "ros2":
        write_bags.write_ros2(partial, messages)
    elif kind == "tum":
        write_tum(partial, trajectory.stamps_ns, trajectory.poses)
    else:
        raise ConfigError(f"{source}: a trajectory has no scans; its targets are X.mcap, X.tum or a folder")
    return {"messages": len(trajectory), "what": "poses", "not_held": [], "losses": list(trajectory.losses)}


def _to_trajectory(source: Path, partial: Path, topic: str | None) -> dict[str, Any]:
    from runtime.formats.mcap_log import is_mcap
    from runtime.formats.poses import read_poses
    from runtime.formats.tum import write_tum

    if not is_mcap(source):
        raise ConfigError(f"{source}: holds no poses of ours; a trajectory comes from an MCAP recording")
    trajectory = read_poses(source, topic)
    write_tum(partial, trajectory.stamps_ns, trajectory.poses)
    not_held = ["covariances", "height, roll and pitch"]
    return {"messages": len(trajectory), "what": "poses", "not_held": not_held, "losses": []}


def _write_carmen(path: Path, log: "LaserLog") -> list[str]:
    from runtime.formats.write_text import write_carmen

    return write_carmen(path, log)


def _write_tinyslam(path: Path, log: "LaserLog") -> list[str]:
    from runtime.formats.write_text import write_tinyslam

    return write_tinyslam(path, log)


def _write_mcap(path: Path, log: "LaserLog") -> list[str]:
    from runtime.formats.write_bags import scan_messages, write_mcap

    write_mcap(path, scan_messages(log), {"from": log.path.name})
    return []


def _write_ros2(path: Path, log: "LaserLog") -> list[str]:
    from runtime.formats.write_bags import scan_messages, write_ros2

    write_ros2(path, scan_messages(log))
    return []


def _write_ros1(path: Path, log: "LaserLog") -> list[str]:
    from runtime.formats.write_bags import scan_messages, write_ros1

    write_ros1(path, scan_messages(log))
    return []


_LOG_WRITERS: dict[str, Callable[[Path, "LaserLog"], list[str]]] = {
    "carmen": _write_carmen,
    "tinyslam": _write_tinyslam,
    "mcap": _write_mcap,
    "ros1": _write_ros1,
    "ros2": _write_ros2,
}


def _is_trajectory(source: Path) -> bool:
    """Whether a file is TUM text: eight numbers in its first line that is no comment."""
    from runtime.formats.errors import FormatError
    from runtime.formats.text import lines_of

    if source.is_dir():
        return False
    try:
        tokens = next((text.split() for _, text in lines_of(source) if not text.startswith("#")), [])
        return len(tokens) == 8 and bool([float(token) for token in tokens])
    except (FormatError, ValueError):
        return False
