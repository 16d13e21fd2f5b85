"""A whole log through the same pipeline as on the robot, in one process, every scan, to a results folder.

No clock is read here: the same log, configuration and seed give the same result, whatever the machine does.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.dpslam.filter import DpSlam
from processing.dpslam.layer import Layer
from processing.dpslam.past import past_of
from processing.dpslam.resume import Returning
from processing.occupancy import OccupancyGrid
from processing.scan import Scan, end_points
from processing.slam import Slam, Step
from runtime.config import to_yaml
from runtime.formats.laser_log import LaserLog
from runtime.formats.map_server import GridMap
from runtime.formats.session import SessionWriter
from runtime.messages import encode
from runtime.nodes.convert import scan_to_message
from runtime.nodes.log_scans import iterate
from runtime.nodes.mounting import of_base
from runtime.nodes.offline_config import OfflineConfig
from runtime.nodes.offline_report import Diary
from runtime.nodes.rows import ancestors_of
from runtime.nodes.saved import Saved, about, grid_map, parts_of
from runtime.reports.results import RunResult, provenance


class OfflineRun:
    """Feeds scans to the pipeline and keeps what the results need.

    Args:
        config: Of everything.
        seed: Of everything.
        saved: A saved map on which the drive begins, somewhere.
        fixed: That map stays as it is: the laser is only followed on it.
    """

    def __init__(
        self, config: OfflineConfig, seed: int, saved: Saved | None = None, fixed: bool = False
    ) -> None:
        self._config, self._seed, self._saved, self._fixed = config, seed, saved, fixed
        mapping: DpSlam | Returning = DpSlam(config.slam.mapping, seed)
        if saved is not None:
            mapping = Returning(saved.past, config.slam.mapping, seed, fixed=fixed, layer=saved.layer)
        self._mapping = mapping
        self._slam = Slam(config.slam, seed, mapping)
        self._stamps_ns: list[int] = []
        self._points_laser: list[NDArray[np.float32]] = []
        self._diary = Diary()
        self.states: Counter[str] = Counter()
        self.state = ""

    def step(self, scan: Scan, missed: int = 0) -> Step:
        """Take the next scan, before which `missed` others never came."""
        step = self._slam.step(scan, missed)
        self._stamps_ns.append(scan.stamp_ns)
        points_laser, _ = end_points(scan, step.match.motion.twist)
        self._points_laser.append(points_laser.astype(np.float32))
        self._diary.take(step)
        looking = isinstance(self._slam.mapping, Returning) and not self._slam.mapping.found
        # Followed or not, a laser that is looked for on its own map is lost. One scan that fits nowhere is no
        # lost laser yet.
        sought = step.mapping.lost and not step.match.motion.lost and not looking
        self.state = "LOST" if sought else step.match.state.name
        self.states[self.state] += 1
        return step

    def result(self, log: LaserLog, extra: Mapping[str, Any] | None = None) -> RunResult:
        """Return everything for the results folder; call it once, at the end.

        Args:
            log: What the scans came from.
            extra: What else the run has to say of itself.
        """
        ancestors = ancestors_of(self._mapping.population)  # the end makes one of all lineages
        self._slam.finish()
        first, layer = self._first_scan, self._layer
        all_stamps_ns, every_pose = self._slam.trajectory()
        stamps_ns, trajectory = all_stamps_ns[first:], every_pose[first:]
        odometry = self._mapping.odometry()[first:]
        if not np.array_equal(stamps_ns, self._stamps_ns):
            raise AssertionError("the trajectory must hold one pose for each scan, in order")
        seen = self._slam.occupancy()
        path = self._mapping.population.path
        occupancy = layer.over(seen, path)
        grid = grid_map(occupancy)
        run = provenance(self._seed, log.path) | {
            "format": log.kind,
            "topic": log.topic,
            "frame": "laser" if self._config.laser_in_base is None else "base_link",
            "scans": {"in_log": len(log), "used": len(stamps_ns)},
            **self._on_saved(),
            "notices": [notice.replace(str(log.path), log.path.name) for notice in log.notices + log.losses],
        }
        metrics = self._metrics(trajectory, grid)

        def report(picture: bytes) -> str:
            return self._diary.tell(
                log.path.name,
                picture,
                np.asarray(stamps_ns, dtype=np.int64),
                trajectory,
                known_m2=metrics["known_m2"],
                facts={name: value for name, value in run.items() if name != "notices"},
                notices=run["notices"],
                config=to_yaml(self._config),
                ancestors=ancestors,
            )

        every = (all_stamps_ns, every_pose)
        return RunResult(
            session=self._session_writer(log, seen, every, about(run)),
            keep_out=layer.keep_out(occupancy, path),
            report=report,
            config=self._config,
            stamps_ns=np.asarray(stamps_ns, dtype=np.int64),
            trajectory=self._of_base(trajectory),
            odometry=self._of_base(odometry),
            grid=grid,
            path_m=trajectory[:, :2],
            metrics=metrics,
            run=run | dict(extra or {}),
            caption=f"{log.path.name}, {len(stamps_ns)} scans, laser alone",
        )

    @property
    def found(self) -> bool:
        """Whether the drive was found on the saved map; true where there is none."""
        return not isinstance(self._mapping, Returning) or self._mapping.found

    @property
    def _first_scan(self) -> int:
        return self._mapping.first_scan if isinstance(self._mapping, Returning) else 0

    @property
    def _layer(self) -> Layer:
        """What is painted on the map that comes out; a drive that was not found has a map of its own."""
        return self._saved.layer if self._saved is not None and self.found else Layer.none()

    def _on_saved(self) -> dict[str, Any]:
        """Return what the run has to say of the saved map."""
        if self._saved is None:
            return {}
        session = self._saved.session
        return {"session": {"name": session.path.name, "drives": session.drives, "found": self.found}}

    def _session_writer(
        self,
        log: LaserLog,
        seen: OccupancyGrid,
        every: tuple[NDArray[np.int64], se2.Pose],
        head: dict[str, str],
    ) -> Callable[[Path], None] | None:
        """Return what writes the session; None where no map was made that one could go on with."""
        if self._fixed or self._mapping.population.keys == 0:
            return None
        past = self._mapping.past() if isinstance(self._mapping, Returning) else past_of(self._mapping)
        parts = parts_of(past, self._layer, seen, to_yaml(self._config), every)

        def write(path: Path) -> None:
            writer, drive = SessionWriter(path, head), 1
            if self._saved is not None and self.found:
                writer.copy(self._saved.session.path)
                drive += self._saved.session.drives
            for scan, _ in zip(iterate(log), self._stamps_ns, strict=False):
                writer.add(drive, scan.stamp_ns, encode(scan_to_message(scan)))
            writer.finish(parts)

        return write

    def _of_base(self, parent_t_laser: se2.Pose) -> se2.Pose:
        """Return the poses of the base, or of the laser where its mounting is not known."""
        if self._config.laser_in_base is None:
            return parent_t_laser
        return of_base(parent_t_laser, self._config.laser_in_base)

    def _metrics(self, map_t_laser: se2.Pose, grid: GridMap) -> dict[str, Any]:
        from processing.sharpness import sharpness

        steps = np.diff(map_t_laser[:, :2], axis=0)
        states = {name: self.states[name] for name in sorted(self.states)}
        metrics: dict[str, Any] = {
            "scans": len(map_t_laser),
            "way_m": float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
            "states": states,
            "known_m2": float(np.count_nonzero(~np.isnan(grid.probability)) * grid.resolution_m**2),
            "resolution_m": grid.resolution_m,
        }
        if any(len(points) for points in self._points_laser):
            points_map = [
                se2.transform(pose, points.astype(np.float64))
                for pose, points in zip(map_t_laser, self._points_laser, strict=True)
            ]
            metrics["sharpness"] = asdict(sharpness(points_map, map_t_laser[:, :2]))
        return metrics
