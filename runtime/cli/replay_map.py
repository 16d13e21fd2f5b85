"""`hallway replay FILE --map`: a recording through the live matcher and mapper, in processes as on the robot.

What was missing from the recording the player tells; what was lost on the way is found afterwards, by holding
the stamps of the result against those sent.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.cli.for_machines import print_json
from runtime.cli.stopping import asked_to_stop
from runtime.errors import ConfigError, DataLostError, HallwayError

if TYPE_CHECKING:
    from runtime.graph import Graph
    from runtime.recordings.replay import Recorded, ReplayConfig
    from runtime.supervision.run import Run

_TURN_S = 0.05


def map_live(args: argparse.Namespace, config: "ReplayConfig") -> int:
    """Play, map and compare; 0 when every scan has its pose, 4 and tables when not, 130 after Ctrl-C."""
    from runtime.config import to_yaml
    from runtime.recordings.replay import Recorded
    from runtime.reports.results import check_free, link_latest

    if len(args.files) != 1 or config.loop or args.topics or args.paused:
        raise ConfigError("--map: plays the scans of one file once; no --loop, --topics or --paused")
    recorded = Recorded(args.files, config)
    if "scan" not in recorded.topics:
        raise ConfigError(f"{args.files[0]}: holds no scan; it holds {', '.join(recorded.topics)}")
    out = args.out or Path("results") / f"{args.files[0].name.split('.')[0]}-live"
    check_free(out)
    graph = _graph(args.files[0].absolute(), config, recorded, args.robot, args.domain)
    with tempfile.TemporaryDirectory(prefix="hallway-replay-") as folder:
        file = Path(folder) / "replay.yaml"
        file.write_text(to_yaml(graph), encoding="utf-8")
        code = _run(file, out, recorded, quiet=args.json)
    if args.out is None:
        link_latest(out)
    return _report(out, recorded, code, args.json)


def _graph(
    file: Path, config: "ReplayConfig", recorded: "Recorded", robot: str | None, domain: int | None
) -> dict[str, Any]:
    from runtime.config import parse_yaml, plain

    nodes: dict[str, Any] = {}
    text = recorded.attachments.get("config.yaml", b"").decode("utf-8", errors="replace")
    if text:
        data = parse_yaml(text, f"{file}: config.yaml")
        nodes = data.get("nodes", {}) if isinstance(data, dict) else {}
    replay = plain(config) | {"topics": ["scan"]}
    return {
        "robot": robot or "replay",
        "domain": domain or 0,
        "seed": recorded.seed or 0,
        "nodes": {
            "mapper": {"module": "mapper", "config": nodes.get("mapper") or {}},
            "matcher": {"module": "matcher", "after": ["mapper"], "config": nodes.get("matcher") or {}},
            "player": {
                "module": "player",
                "after": ["mapper", "matcher"],
                "restart": "never",
                "config": {"file": str(file), "replay": replay},
            },
        },
    }


def _run(file: Path, out: Path, recorded: "Recorded", quiet: bool) -> int:
    """Run the graph until the player has ended; return 0, 130, or why it failed."""
    import shutil

    from runtime import graph as graphs
    from runtime import rundir
    from runtime.bus.zenoh_bus import ZenohBus
    from runtime.cli.compiling import compile_all
    from runtime.clock import Clock
    from runtime.reports.results import provenance
    from runtime.supervision.run import Run, collect
    from runtime.supervision.supervisor import child_environment

    compile_all(child_environment(Clock()), _say)
    graph = graphs.load(file)
    if out.is_dir():
        shutil.rmtree(out)
    out.mkdir(parents=True)
    with rundir.claimed(graph.robot) as run_dir:
        live = Run(graph, file, run_dir, out, open_bus=ZenohBus, on_event=_teller(quiet))
        try:
            interrupted = _drive(live)
        finally:
            live.close()
        failed = live.supervisor.failed
        code = (failed.exit_code or 1) if failed is not None else 130 if interrupted else 0
        about = {**provenance(graph.seed), **live.summary(), "exit_code": code}
        collect(out, list(graph.nodes), about, _config(graph))
    if failed is not None and failed.reasons:
        print(f"hallway replay: {failed.name}: {failed.reasons[-1]}", file=sys.stderr)
    return code


def _say(line: str) -> None:
    print(f"hallway replay: {line}", file=sys.stderr, flush=True)


def _teller(quiet: bool) -> Any:
    def tell(event: Any) -> None:
        if not quiet:
            print(f"  {event.node}: {event.text}", file=sys.stderr, flush=True)

    return tell


def _config(graph: "Graph") -> dict[str, Any]:
    nodes = {name: node.config for name, node in graph.nodes.items()}
    return {"robot": graph.robot, "seed": graph.seed, "nodes": nodes}


def _drive(live: "Run") -> bool:
    """Turn until everything has ended; return whether a person ended it."""
    from runtime.supervision.child import State

    with asked_to_stop() as asked:
        while not live.supervisor.over:
            live.step()
            player = live.supervisor.children["player"]
            if asked or player.state is State.ENDED or live.supervisor.idle:
                live.supervisor.stop()
            time.sleep(_TURN_S)
    return bool(asked)


def _report(out: Path, recorded: "Recorded", code: int, as_json: bool) -> int:
    from runtime.cli.gaps import print_gaps
    from runtime.formats.tum import kept_ns, read_tum, tum_stamp

    played_file, result_file = out / "played.json", out / "trajectory.tum"
    if code not in (0, 130):
        return code  # the reason was said
    if not played_file.is_file():
        raise HallwayError(f"{out}: the run left no account of what was played; see {out}/logs")
    played = json.loads(played_file.read_text(encoding="utf-8"))
    sent = played["scan_stamps_ns"]
    mapped = set(read_tum(result_file).stamps_ns.tolist()) if result_file.is_file() else set()
    missing = [(n, s) for n, s in enumerate(sent, start=1) if kept_ns(s) not in mapped]
    report = {
        "out": str(out),
        "sent": len(sent),
        "mapped": len(sent) - len(missing),
        "missing": [{"scan": n, "stamp": tum_stamp(s)} for n, s in missing],
        "gaps": played["gaps"],
        "outages": played["outages"],
        "losses": played["losses"],
    }
    if as_json:
        print_json(report)
    else:
        print(f"{out}/: {report['mapped']} of {report['sent']} scans mapped")
        print_gaps("not in the recording", report["gaps"])
        print_gaps("sent, and not in the map", _runs(missing, recorded.began_ns))
        for one in report["outages"] + report["losses"]:
            print(f"hallway replay: {one}", file=sys.stderr)
    if code == 130:
        return 130
    return int(DataLostError.exit_code) if missing or report["losses"] else 0


def _runs(missing: list[tuple[int, int]], began_ns: int) -> list[dict[str, Any]]:
    """Return scans (number among those sent, stamp) as rows of a table, neighbours in one."""
    rows: list[dict[str, Any]] = []
    for n, stamp_ns in missing:
        if rows and rows[-1]["first"] + rows[-1]["count"] == n:
            rows[-1]["count"] += 1
        else:
            rows.append({"topic": "scan", "at_s": (stamp_ns - began_ns) / 1e9, "first": n, "count": 1})
    return rows
