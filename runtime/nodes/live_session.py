"""What a live mapper does with sessions: begins on one, and leaves one."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam, MapStep
from processing.dpslam.layer import Layer
from processing.dpslam.past import past_of
from processing.dpslam.resume import Returning
from processing.occupancy import OccupancyGrid
from processing.scan import Scan
from runtime.config import to_yaml
from runtime.nodes.saved import Saved, load, parts_of, places_in_words
from runtime.nodes.scan_keeper import Kept, ScanKeeper
from runtime.port import Port
from runtime.reports.results import provenance

Mapper = DpSlam | Returning


class LiveSession:
    """The session that a mapper begins on, if any, and the one that it leaves.

    Args:
        port: Of the mapper.
        session: Path of the saved map; empty for none.
        extend: Whether it grows.
        mapping: Of the mapper.
        earlier: Scans that the processes before this one have kept.
    """

    def __init__(
        self, port: Port, session: str, extend: bool, mapping: DpSlamConfig, earlier: Kept = ()
    ) -> None:
        self._port, self._mapping, self._extend = port, mapping, extend
        self._saved: Saved | None = load(Path(session)) if session else None
        self._fixed = self._saved is not None and not extend
        home = None if port.results_dir is None or self._fixed else port.results_dir.parent
        head = {name: str(value) for name, value in provenance(port.seed).items() if name != "host"}
        self._scans = ScanKeeper(home, head, port.log, earlier)

    @property
    def begins_on_map(self) -> bool:
        """Whether there is a saved map."""
        return self._saved is not None

    def mapper(self) -> Mapper:
        """Return the mapper of a drive that begins now."""
        if self._saved is None:
            return DpSlam(self._mapping, self._port.seed)
        past, layer = self._saved.past, self._saved.layer
        return Returning(past, self._mapping, self._port.seed, fixed=self._fixed, layer=layer)

    def add(self, scan: Scan) -> None:
        """Keep a scan that was worked in."""
        self._scans.add(scan)

    def kept(self) -> Kept:
        """Return what a process after a kill needs to know."""
        return self._scans.kept()

    def still_looking(self, mapper: Mapper, step: MapStep) -> bool:
        """Say so while the drive is not found: its pose on the map is then not known."""
        if not isinstance(mapper, Returning) or mapper.found:
            return False
        if len(step.places) > 1:
            places = places_in_words(step.places)
            text = f"{len(step.places)} places of the saved map fit equally: {places}; drive on"
        else:
            text = "looking for itself on the saved map; drive on"
        self._port.report("warn", text, looks=mapper.finder.looks)
        return True

    def layer(self, mapper: Mapper) -> Layer:
        """Return what is painted on the map that comes out."""
        found = not isinstance(mapper, Returning) or mapper.found
        return self._saved.layer if self._saved is not None and found else Layer.none()

    def leave(
        self, mapper: Mapper, seen: OccupancyGrid
    ) -> tuple[Callable[[Path], None] | None, NDArray[np.bool_]]:
        """Return what writes the session, if there is to be one, and the mask of what is kept out."""
        layer, population = self.layer(mapper), mapper.population
        keep_out = layer.keep_out(seen, population.path)
        if self._fixed or not self._scans.whole:
            return None, keep_out
        past = mapper.past() if isinstance(mapper, Returning) else past_of(mapper)
        config = to_yaml({"slam": {"mapping": self._mapping}})
        parts = parts_of(past, layer, seen, config, mapper.trajectory())
        found = isinstance(mapper, Returning) and mapper.found
        before = self._saved.session if self._saved is not None and found else None
        return (lambda path: self._scans.write(path, parts, before)), keep_out

    def about(self, mapper: Mapper) -> Mapping[str, Any]:
        """Return what the run has to say of the saved map."""
        if self._saved is None or not isinstance(mapper, Returning):
            return {}
        session = self._saved.session
        return {"session": {"name": session.path.name, "drives": session.drives, "found": mapper.found}}


def shown(mapper: Mapper) -> Mapper:
    """Return whose map is published: the saved one as long as the drive is not found on it."""
    return mapper.saved if isinstance(mapper, Returning) and not mapper.found else mapper
