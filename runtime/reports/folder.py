"""The page about a run that was live, made of the files that it left."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.formats.tum import read_tum
from runtime.reports.report import ReportData, write_report
from runtime.reports.results import PICTURE_FILE, REPORT_FILE


def report_on(folder: Path, title: str) -> bool:
    """Write the page into a results folder; False if there is no picture of a map and no trajectory in it."""
    if not (folder / PICTURE_FILE).is_file() or not (folder / "trajectory.tum").is_file():
        return False
    trajectory = read_tum(folder / "trajectory.tum")
    metrics, run = _json(folder / "metrics.json"), _json(folder / "run.json")
    metrics.pop("way_m", None)  # in the first line, as the picture shows it
    latency = metrics.pop("latency", {})
    config = folder / "config.yaml"
    data = ReportData(
        title=title,
        picture=(folder / PICTURE_FILE).read_bytes(),
        known_m2=metrics.pop("known_m2", None),
        stamps_ns=trajectory.stamps_ns,
        map_t_laser=trajectory.poses,
        **_match(folder, trajectory.stamps_ns),
        **_particles(folder, trajectory.stamps_ns),
        latency_ms=latency.pop("hops", {}),
        counts={**{k: v for k, v in latency.items() if k != "unit"}, **_processes(run.pop("processes", {}))},
        notices=_last_words(run),
        facts={**metrics, **{name: value for name, value in run.items() if name != "events"}},
        config=config.read_text(encoding="utf-8") if config.is_file() else "",
    )
    write_report(folder / REPORT_FILE, data)
    return True


def _match(folder: Path, stamps_ns: NDArray[np.int64]) -> dict[str, Any]:
    """Return what the matcher noted, for each scan; nothing where it noted nothing."""
    rows = _rows(folder / "match.csv")
    if not rows:
        return {}
    at = _places(rows, stamps_ns)
    state, score, points, best_mm, worst_mm = zip(*(row[1:6] for row in rows), strict=True)
    sigma_m = np.array((best_mm, worst_mm), dtype=np.float64).T / 1e3
    return {
        "states": np.array(state)[at].tolist(),
        "score": np.array(score, dtype=np.float64)[at],
        "points": np.array(points, dtype=np.int64)[at],
        "sigma_m": sigma_m[at],
    }


def _particles(folder: Path, stamps_ns: NDArray[np.int64]) -> dict[str, Any]:
    """Return what the mapper noted at its key scans, for each scan, and its particles at the end."""
    told: dict[str, Any] = {}
    if rows := _rows(folder / "keys.csv"):
        at = _places(rows, stamps_ns)
        told["n_eff"] = np.array([row[1] for row in rows], dtype=np.float64)[at]
        chosen = np.array([int(row[0]) for row in rows if row[2] == "1"], dtype=np.int64)
        told["resampled"] = np.isin(_micros(stamps_ns), _micros(chosen))
    if (folder / "particles.npz").is_file():
        with np.load(folder / "particles.npz") as arrays:
            told |= {name: arrays[name] for name in ("particles", "ancestors")}
    return told


def _rows(path: Path) -> list[list[str]]:
    """Return the rows of a table without its head; without the last one if its process was cut off in it."""
    lines = path.read_text(encoding="ascii").splitlines() if path.is_file() else []
    width = lines[0].count(",") if lines else 0
    return [line.split(",") for line in lines[1:] if line.count(",") == width and line[0].isdigit()]


def _places(rows: list[list[str]], stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return which row held at each scan: that of its own stamp, or the newest before it."""
    noted_ns = np.maximum.accumulate(np.array([int(row[0]) for row in rows]))
    return np.clip(np.searchsorted(_micros(noted_ns), _micros(stamps_ns), side="right") - 1, 0, None)


def _micros(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return microseconds, as trajectory files have them."""
    return (stamps_ns + 500) // 1000


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
