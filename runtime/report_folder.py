"""The page about a run that was live, made of the files that it left."""

import json
from pathlib import Path
from typing import Any

from runtime.formats.map_server import read_map
from runtime.formats.tum import read_tum
from runtime.report import ReportData, write_report

REPORT_FILE = "report.html"


def report_on(folder: Path, title: str) -> bool:
    """Write the page into a results folder; False if there is no map and trajectory in it."""
    if not (folder / "map.yaml").is_file() or not (folder / "trajectory.tum").is_file():
        return False
    grid, trajectory = read_map(folder / "map.yaml"), read_tum(folder / "trajectory.tum")
    metrics, run = _json(folder / "metrics.json"), _json(folder / "run.json")
    latency = metrics.pop("latency", {})
    config = folder / "config.yaml"
    data = ReportData(
        title=title,
        probability=grid.probability,
        resolution_m=grid.resolution_m,
        origin_m=grid.origin_m,
        stamps_ns=trajectory.stamps_ns,
        map_t_laser=trajectory.poses,
        latency_ms=latency.pop("hops", {}),
        counts={**{k: v for k, v in latency.items() if k != "unit"}, **_processes(run.pop("processes", {}))},
        notices=_last_words(run),
        facts={**metrics, **{name: value for name, value in run.items() if name != "events"}},
        config=config.read_text(encoding="utf-8") if config.is_file() else "",
    )
    write_report(folder / REPORT_FILE, data)
    return True


def _json(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def _processes(processes: dict[str, Any]) -> dict[str, str]:
    """Return how often each process was started again, and why the last time."""
    return {
        f"{name}, started again": f"{one['restarts']}: {one['reasons'][-1] if one['reasons'] else ''}"
        for name, one in processes.items()
        if one["restarts"]
    }


def _last_words(run: dict[str, Any]) -> list[str]:
    """Return what went wrong on the way, in words."""
    wrong = ("failed", "killed", "ended with", "was not ready", "stopped", "silent")
    lines = [line.partition(" ")[2] for line in run.get("events", [])]
    return [line for line in lines if any(word in line for word in wrong)][-20:]
