"""A whole log through the same pipeline as on the robot, in one process, every scan, to a results folder.

No clock is read here: the same log, configuration and seed give the same result, whatever the machine does.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.scan import Scan, end_points
from processing.slam import Slam, SlamConfig, Step
from runtime.config import to_yaml
from runtime.formats.laser_log import LaserLog
from runtime.formats.map_server import GridMap
from runtime.nodes.offline_report import Diary
from runtime.results import RunResult, provenance


@dataclass(frozen=True, slots=True, kw_only=True)
class OfflineConfig:
    """Everything that decides a map, apart from log and seed."""

    slam: SlamConfig = field(default_factory=SlamConfig)
    laser_in_base: tuple[float, float, float] | None = None
    """Mounting of the laser: x, y (m) and yaw (rad) in the base frame; the poses are then the base's."""

    def __post_init__(self) -> None:
        if self.laser_in_base is not None and not np.all(np.isfinite(self.laser_in_base)):
            raise ValueError(f"laser_in_base = {self.laser_in_base}, must be three finite numbers")


def recorded_config(text: str, where: str) -> OfflineConfig:
    """Return the configuration under which a recorded run mapped, from the YAML in its recording.

    Raises:
        ConfigError: A parameter in it does not exist here; the text names it.
    """
    from runtime.config import build, parse_yaml

    data = parse_yaml(text, where)
    nodes = data.get("nodes") if isinstance(data, dict) else None
    if not isinstance(nodes, dict):
        return OfflineConfig()
    parts: dict[str, Any] = {}
    for node, part in (("matcher", "odometry"), ("mapper", "mapping")):
        config = nodes.get(node)
        if isinstance(config, dict) and part in config:
            parts[part] = config[part]
    return OfflineConfig(slam=build(SlamConfig, parts, f"{where}: nodes"))


class OfflineRun:
    """Feeds scans to the pipeline and keeps what the results need."""

    def __init__(self, config: OfflineConfig, seed: int) -> None:
        self._config, self._seed = config, seed
        self._slam = Slam(config.slam, seed)
        self._stamps_ns: list[int] = []
        self._odometry: list[se2.Pose] = []
        self._points_laser: list[NDArray[np.float32]] = []
        self._diary = Diary()
        self.states: Counter[str] = Counter()
        self.state = ""

    def step(self, scan: Scan) -> Step:
        """Take the next scan."""
        step = self._slam.step(scan)
        self._stamps_ns.append(scan.stamp_ns)
        self._odometry.append(step.match.motion.odom_t_laser)
        points_laser, _ = end_points(scan, step.match.motion.twist)
        self._points_laser.append(points_laser.astype(np.float32))
        self._diary.take(step)
        self.state = step.match.state.name
        self.states[self.state] += 1
        return step

    def result(self, log: LaserLog, extra: Mapping[str, Any] | None = None) -> RunResult:
        """Return everything for the results folder; call it once, at the end.

        Args:
            log: What the scans came from.
            extra: What else the run has to say of itself.
        """
        self._slam.finish()
        stamps_ns, trajectory = self._slam.trajectory()
        odometry = np.array(self._odometry).reshape(-1, 3)
        if not np.array_equal(stamps_ns, self._stamps_ns):
            raise AssertionError("the trajectory must hold one pose for each scan, in order")
        occupancy = self._slam.occupancy()
        grid = GridMap(occupancy.probability, occupancy.resolution_m, occupancy.origin_m)
        run = provenance(self._seed, log.path) | {
            "format": log.kind,
            "topic": log.topic,
            "frame": "laser" if self._config.laser_in_base is None else "base_link",
            "scans": {"in_log": len(log), "used": len(stamps_ns)},
            "notices": [notice.replace(str(log.path), log.path.name) for notice in log.notices + log.losses],
        }
        report = self._diary.tell(
            log.path.name,
            occupancy,
            np.asarray(stamps_ns, dtype=np.int64),
            trajectory,
            facts={name: value for name, value in run.items() if name != "notices"},
            notices=run["notices"],
            config=to_yaml(self._config),
        )
        return RunResult(
            report=report,
            config=self._config,
            stamps_ns=np.asarray(stamps_ns, dtype=np.int64),
            trajectory=self._of_base(trajectory),
            odometry=self._of_base(odometry),
            grid=grid,
            path_m=trajectory[:, :2],
            metrics=self._metrics(trajectory, grid),
            run=run | dict(extra or {}),
            caption=f"{log.path.name}, {len(stamps_ns)} scans, laser alone",
        )

    def _of_base(self, parent_t_laser: se2.Pose) -> se2.Pose:
        """Return the poses of the base, or of the laser where its mounting is not known."""
        if self._config.laser_in_base is None:
            return parent_t_laser
        return se2.compose(parent_t_laser, se2.invert(np.array(self._config.laser_in_base)))

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


def default_folder(log: Path, results: Path = Path("results")) -> Path:
    """Return where the results of a log go when nobody says: `results/<name of the log>`."""
    name = log.name.split(".")[0] or log.name
    return results / name
