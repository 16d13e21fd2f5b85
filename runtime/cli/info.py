"""Say what is in a recording, log or run, and what is missing.

Takes recordings, laser logs, bags, sessions and folders of results.
"""

import argparse
import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from runtime.cli.for_machines import print_json
from runtime.errors import DataLostError

_DATED_S = 631_152_000.0
"""1990: no log is older, and no sensor was on for twenty years."""
PAINTS = {"erased": 1, "wall": 2, "keep_out": 3}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("file", type=Path, help="recording (also cut), session, log, bag, or folder")
    parser.add_argument("--topic", metavar="T", help="which laser of a bag")
    parser.add_argument("--json", action="store_true", help="machine-readable, one object")


def run(args: argparse.Namespace) -> int:
    """Print what is there; 0 when it is whole, 4 when something is missing."""
    from runtime.formats.mcap_log import is_mcap
    from runtime.reports.results import RUN_FILE

    path: Path = args.file
    if path.is_dir() and (path / RUN_FILE).is_file():
        report = _results(path)
    elif is_mcap(path):
        from runtime.recordings.info import describe

        report = _with_session(describe(path), path)
    else:
        report = _log(path, args.topic)
    if args.json:
        print_json(report)
    else:
        _print(report)
    return int(DataLostError.exit_code) if report.get("missing") else 0


def _with_session(report: dict[str, Any], path: Path) -> dict[str, Any]:
    """Add what a session has beside its scans, and whether it can be gone on with."""
    from runtime.formats.errors import FormatError
    from runtime.formats.session import RECORD, SUMS, read_session

    record = report.pop(RECORD, None)
    report.pop(SUMS, None)
    if record is None:
        return report
    try:
        parts = read_session(path).parts
    except FormatError as error:
        report["missing"].append(str(error))
        return report | {"kind": "session", "session": record}
    painted = {name: int((parts.layer["paints"] == number).sum()) for name, number in PAINTS.items()}
    held = {
        "resolution_m": parts.resolution_m,
        "origin_m": list(parts.origin_m),
        "key_scans": len(parts.posterior["keys"]),
        "painted_cells": painted,
    }
    return report | {"kind": "session", "session": record | held}


def _results(path: Path) -> dict[str, Any]:
    report: dict[str, Any] = {"file": str(path), "kind": "results"}
    for name in ("run.json", "metrics.json"):
        if (path / name).is_file():
            report |= json.loads((path / name).read_text(encoding="utf-8"))
    report["files"] = sorted(one.name for one in path.iterdir())
    return report


def _log(path: Path, topic: str | None) -> dict[str, Any]:
    from dataclasses import asdict

    from runtime.formats.logs import open_log

    log = open_log(path, topic)
    stamps_s = log.stamps_ns / 1e9
    return {
        "file": str(path),
        "kind": log.kind,
        "topic": log.topic,
        "scans": len(log),
        "duration_s": float(stamps_s.max() - stamps_s.min()),
        **asdict(log.geometry),
        "notices": list(log.notices),
        "missing": list(log.losses),
    }


def _print(report: dict[str, Any]) -> None:
    from runtime.cli.fitting import fitted
    from runtime.cli.gaps import print_gaps

    topics = report.get("topics")
    for key, value in report.items():
        if key in ("topics", "missing", "notices", "gaps", "outages") or value is None:
            continue
        if key == "began_s":
            key, value = "began", _began(value)
        if key == "events":
            value = f"{len(value)}, in run.json and in the logs"
        for name, part in _parts(key, value):
            print(fitted(f"{name:<20} {_text(part)}", 21))
    if topics:
        width = max(map(len, topics))
        print(f"{'topic':<{width}} {'messages':>9}{'Hz':>8}{'missing':>9}  type")
        for name, row in topics.items():
            rate = "" if row["rate_hz"] is None else f"{row['rate_hz']:.2f}"
            print(f"{name:<{width}} {row['messages']:>9}{rate:>8}{row['missing']:>9}  {row['type']}")
    print_gaps("missing messages of", report.get("gaps", []))
    for key in ("outages", "notices", "missing"):
        for one in report.get(key, []):
            print(fitted(f"{key.rstrip('s'):<20} {one}", 21))


def _parts(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield what stands on a line of its own: each of what has parts itself, and all the rest together."""
    wholes = {key: one for key, one in value.items() if _has_parts(one)} if isinstance(value, dict) else {}
    if _has_parts(value):
        wholes = value
    rest = {key: one for key, one in value.items() if key not in wholes} if wholes else value
    if rest or not wholes:
        yield name, rest
    for key, one in wholes.items():
        yield from _parts(f"{name} {key}", one)


def _has_parts(value: Any) -> bool:
    """Whether a value holds nothing but others that hold some."""
    return isinstance(value, dict) and bool(value) and all(isinstance(one, dict) for one in value.values())


def _began(stamp_s: float) -> str:
    """Return a date, or seconds where the stamps are of a clock that knows none, such as a sensor's own."""
    if stamp_s < _DATED_S:
        return f"at {stamp_s:.3f} s of a clock that knows no date"
    return f"{datetime.fromtimestamp(stamp_s, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return ", ".join(
            f"{key}=({_text(one)})" if one and isinstance(one, dict | list) else f"{key}={_text(one)}"
            for key, one in value.items()
        )
    if isinstance(value, list):
        return ", ".join(map(_text, value)) or "none"
    return str(value)
