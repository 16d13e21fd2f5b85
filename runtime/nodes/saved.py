"""Between sessions on disk and the mapper: what is written at the end of a drive, and read before the next.

A session written by another version is drawn anew by this one; what this one cannot read it refuses.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from processing.dpslam.layer import Layer
from processing.dpslam.past import Past
from processing.occupancy import OccupancyGrid
from processing.se2 import Pose
from runtime.formats.map_server import GridMap, trinary
from runtime.formats.session import CutSessionError, Parts, Session, read_session
from runtime.formats.tum import tum_lines
from runtime.nodes.offline_config import OfflineConfig, recorded_config
from runtime.reports.picture import png


@dataclass(frozen=True, slots=True, eq=False)
class Saved:
    """A session that can be gone on with."""

    session: Session
    past: Past
    layer: Layer

    @property
    def config(self) -> OfflineConfig:
        """The configuration under which it was made; raises ConfigError for a key that is no longer known."""
        return recorded_config(self.session.parts.config, f"{self.session.path}: config.yaml")


def load(path: Path) -> Saved:
    """Read a session, a file or a results folder with one in it.

    Raises:
        FormatError: It is something else, of another format, cut or damaged.
    """
    session = read_session(path)
    try:
        past = Past(**{name: np.ascontiguousarray(value) for name, value in session.parts.posterior.items()})
        layer = Layer(**session.parts.layer)
        if layer.keys.max(initial=0) >= len(past.keys):
            raise ValueError(f"the layer is tied to key scan {layer.keys.max()} of {len(past.keys)}")
    except (TypeError, ValueError) as error:
        raise CutSessionError(session.path, f"what is in it does not fit together: {error}") from error
    return Saved(session, past, layer)


def parts_of(
    past: Past, layer: Layer, seen: OccupancyGrid, config: str, trajectory: tuple[Any, Pose]
) -> Parts:
    """Return the end of a session.

    Args:
        past: Of the mapper.
        layer: What is painted on its map.
        seen: The map without the layer.
        config: YAML.
        trajectory: Stamps (N,) and map_t_laser (N, 3) of every drive.
    """
    return Parts(
        posterior=past.arrays(),
        config=config,
        trajectory="".join(tum_lines(*trajectory)).encode("ascii"),
        picture=picture_of(layer.over(seen, past.map_t_laser)),
        resolution_m=seen.resolution_m,
        origin_m=seen.origin_m,
        layer=layer.arrays(),
    )


def picture_of(grid: OccupancyGrid) -> bytes:
    """Return the picture of a map, the same grey as `map.pgm`, as PNG."""
    return png(Image.fromarray(np.ascontiguousarray(trinary(grid.probability))))


def grid_map(grid: OccupancyGrid) -> GridMap:
    """Return a map as it is written."""
    return GridMap(grid.probability, grid.resolution_m, grid.origin_m)


def about(run: Mapping[str, Any]) -> dict[str, str]:
    """Return the head of a session from what a run says of itself."""
    kept = {name: str(run[name]) for name in ("version", "seed", "python", "numpy", "numba") if name in run}
    if isinstance(run.get("input"), Mapping):
        kept["input"] = str(run["input"]["name"])
    return kept


def places_in_words(places: tuple[Pose, ...]) -> str:
    """Return places for people: metres and degrees."""
    return " and ".join(f"({x:.2f} m, {y:.2f} m, {np.degrees(yaw):.0f} deg)" for x, y, yaw in places)
