"""How a run of `hallway up` ends: its exit code, what it leaves in the folder of results, its last words."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.cli.fitting import print_written
from runtime.cli.for_machines import print_json

if TYPE_CHECKING:
    from runtime.supervision.child import Child
    from runtime.supervision.run import Run
    from runtime.supervision.supervisor import Event


def in_short(live: "Run", event: "Event") -> str:
    """Return what happened, without the reason that ends the run: it is the last word, and said there."""
    from runtime.supervision.child import State

    child = live.supervisor.children.get(event.node)
    ends_all = child is not None and child.state is State.FAILED and child.spec.required
    return "failed, and ends the run" if ends_all else event.text


def _reason(failed: "Child | None") -> str:
    """Return why the run failed, and what to do where no robot is at hand; empty if it did not."""
    if failed is None or not failed.reasons:
        return ""
    reason = f"{failed.name}: {failed.reasons[-1]}"
    robot_missing = failed.spec.module == "base" and failed.exit_code == 3
    return reason + " No robot? `hallway up handheld` maps with the laser alone." * robot_missing


def exit_code(live: "Run", interrupted: bool) -> int:
    """Return that of the process that ended the run, 130 if a person did, else 0."""
    failed = live.supervisor.failed
    if failed is not None:
        return failed.exit_code or 1
    return 130 if interrupted else 0


def save(
    live: "Run", config: dict[str, Any], out: Path, args: argparse.Namespace, code: int
) -> dict[str, Any]:
    """Write what the processes have left and the report on it; return what `say` tells."""
    from runtime.reports.folder import report_on
    from runtime.reports.results import link_latest, provenance
    from runtime.supervision.run import collect

    about = {
        **provenance(live.graph.seed),
        "graph": args.graph,
        **live.summary(),
        "exit_code": code,
        "finished": True,
    }
    about["events"] = [f"{e.stamp_ns} {e.node}: {e.text}" for e in live.events]
    metrics = collect(out, list(live.graph.nodes), about, config)
    report_on(out, f"{live.graph.robot}, {args.graph}")
    if args.out is None:
        link_latest(out)
    reason = _reason(live.supervisor.failed)
    return {"out": str(out), "exit_code": code, "reason": reason, **live.summary(), "metrics": metrics}


def say(report: dict[str, Any], as_json: bool) -> None:
    """Print the last words: why it failed, scans used, processes started again, files written."""
    if report["reason"]:
        print(f"hallway up: {report['reason']}", file=sys.stderr)
    if as_json:
        print_json(report)
        return
    latency = report["metrics"].get("latency", {})
    scans, mapped = latency.get("scans", 0), latency.get("mapped", 0)
    if scans:
        late = f", {latency['late']} too late" if latency.get("late") else ""
        print(f"used {mapped} of {scans} scans{late}")
    for name, process in report["processes"].items():
        told = report["reason"].startswith(f"{name}: ")
        if process["restarts"] or (process["state"] == "failed" and not told):
            last = "" if told else f", last: {process['reasons'][-1]}"
            print(f"{name}: {process['restarts']} restarts{last}")
    written = sorted(p.name for p in Path(report["out"]).iterdir() if p.is_file())
    print_written(report["out"], written)
