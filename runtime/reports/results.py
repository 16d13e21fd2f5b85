"""The results of a run: one folder, complete or not there at all.

Everything is written into a folder beside the final one and renamed in one step. The same result gives the
same bytes: no wall time, no duration, no path of this machine goes into any file.
"""

import hashlib
import json
import os
import platform
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.config import plain, to_yaml
from runtime.errors import ConfigError
from runtime.formats import session
from runtime.formats.map_server import GridMap, write_keep_out, write_map
from runtime.formats.tum import write_tum
from runtime.reports.picture import png, render

RUN_FILE = "run.json"
PICTURE_FILE = "map.png"
REPORT_FILE = "report.html"
LATEST = "latest"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RunResult:
    """What a run leaves behind; poses (N, 3) are of the base if its mounting is known, else of the laser."""

    config: Any
    """The resolved configuration: a dataclass or a mapping."""
    stamps_ns: NDArray[np.int64]
    """(N,) raw, in the order of the scans."""
    trajectory: NDArray[np.float64]
    """(N, 3) in the map frame."""
    odometry: NDArray[np.float64]
    """(N, 3) in the odom frame."""
    grid: GridMap
    path_m: NDArray[np.float64]
    """(N, 2) of the laser in the map frame, for the picture."""
    metrics: Mapping[str, Any] = field(default_factory=dict)
    run: Mapping[str, Any] = field(default_factory=dict)
    """Version, seed, input: what is needed to make the run again."""
    caption: str = ""
    report: Callable[[bytes], str] | None = None
    """Makes a page about the run, see `runtime.reports.report`, with the picture of the map, PNG."""
    session: Callable[[Path], None] | None = None
    """Writes the session to a path; see `runtime.formats.session`."""
    keep_out: NDArray[np.bool_] | None = None
    """(rows, cols) of the grid that a robot shall keep out of; a mask of its own if there is any."""


def save(folder: Path, result: RunResult) -> None:
    """Write the results folder; an earlier results folder of that name is replaced, any other is left alone.

    Raises:
        ConfigError: `folder` holds something that is no results folder.
    """
    with new_folder(folder) as partial:
        (partial / "config.yaml").write_text(to_yaml(result.config), encoding="utf-8")
        write_tum(partial / "trajectory.tum", result.stamps_ns, result.trajectory)
        write_tum(partial / "odometry.tum", result.stamps_ns, result.odometry)
        picture = write_products(partial, result.grid, result.path_m, result.keep_out, result.caption)
        if result.report is not None:
            (partial / REPORT_FILE).write_text(result.report(picture), encoding="utf-8")
        if result.session is not None:
            result.session(partial / session.FILE)
        (partial / "metrics.json").write_text(to_json(result.metrics), encoding="utf-8")
        (partial / RUN_FILE).write_text(to_json(result.run), encoding="utf-8")


def write_products(
    folder: Path,
    grid: GridMap,
    path_m: NDArray[np.float64],
    keep_out: NDArray[np.bool_] | None,
    caption: str,
) -> bytes:
    """Write a map as map_server reads it, with the mask of what a robot shall keep out of, and its picture.

    Args:
        folder: Where.
        grid: The map.
        path_m: (N, 2) of the laser in the map frame.
        keep_out: (rows, cols) of the grid, or None.
        caption: Under the picture.

    Returns:
        The picture, PNG, as it was written.
    """
    write_map(folder, grid)
    if keep_out is not None and keep_out.any():
        write_keep_out(folder, keep_out, grid)
    image = render(
        grid.probability, grid.resolution_m, grid.origin_m, path_m, keep_out=keep_out, caption=caption
    )
    picture = png(image)
    (folder / PICTURE_FILE).write_bytes(picture)
    return picture


def to_json(value: Any) -> str:
    """Return JSON for machines and people: indented, in the given order, NaN as null."""
    return json.dumps(_finite(plain(value)), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Yield a folder to write into: it becomes `folder` when the block ends well, and vanishes otherwise."""
    check_free(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".partial", dir=folder.parent))
    partial.chmod(0o755)
    try:
        yield partial
        for path in partial.rglob("*"):
            _sync(path)
        if folder.exists():
            old = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".old", dir=folder.parent))
            folder.replace(old)  # an empty folder may be replaced by a folder
            partial.replace(folder)
            shutil.rmtree(old)
        else:
            partial.replace(folder)
        _sync(folder.parent)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def default_folder(log: Path, results: Path = Path("results")) -> Path:
    """Return where the results of a log go when nobody says: `results/<name of the log>`."""
    name = log.name.split(".")[0] or log.name
    return results / name


def check_free(folder: Path) -> None:
    """Refuse a results folder that is something else, before any work is done; raises ConfigError."""
    if folder.is_dir():
        if folder.is_mount() or Path.cwd().is_relative_to(folder.resolve()):
            # It is replaced in one step: who stands in it would stand nowhere, and a disk cannot be moved.
            inside = folder / "map"
            raise ConfigError(f"{folder}: is where you are, or a disk; choose a folder in it, {inside}")
        if any(folder.iterdir()) and not (folder / RUN_FILE).is_file():
            raise ConfigError(f"{folder}: holds other files and no {RUN_FILE}; choose another folder")
    elif folder.exists():
        raise ConfigError(f"{folder}: is a file, must be a folder or not exist")
    check_writable(folder)


def check_writable(path: Path) -> None:
    """Refuse a file or folder that cannot be made where it shall be, before any work; raises ConfigError."""
    parent = next(one for one in path.absolute().parents if one.exists())
    try:
        # Tried, not asked: root is told that it may write anywhere, also into /proc.
        with tempfile.TemporaryFile(dir=parent):
            return
    except OSError as error:
        raise ConfigError(f"{path}: {parent} cannot be written to") from error


def link_latest(folder: Path) -> None:
    """Let the link `latest` beside the folder point to it, in one step; a real file of that name stays."""
    link = folder.parent / LATEST
    if link.exists() and not link.is_symlink():
        return
    fresh = folder.parent / f".{LATEST}.{os.getpid()}"
    fresh.unlink(missing_ok=True)
    fresh.symlink_to(folder.name)
    fresh.replace(link)


def provenance(seed: int, source: Path | None = None) -> dict[str, Any]:
    """Return what a run must say of itself: versions, host, seed, and the input by name and content."""
    about: dict[str, Any] = {
        "version": _version("hallway"),
        "seed": seed,
        "host": {"machine": platform.machine(), "system": platform.system(), "node": platform.node()},
        "python": platform.python_version(),
        "numpy": _version("numpy"),
        "numba": _version("numba"),
    }
    if source is not None:
        about["input"] = {"name": source.name, "sha256": content_hash(source)}
    return about


def content_hash(path: Path) -> str:
    """Return the SHA-256 of a file, or of all files of a folder in the order of their names."""
    digest = hashlib.sha256()
    files = sorted(one for one in path.rglob("*") if one.is_file()) if path.is_dir() else [path]
    for file in files:
        if path.is_dir():
            digest.update(str(file.relative_to(path)).encode())
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_finite(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
