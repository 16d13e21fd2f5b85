"""Mapper process: scans and motions in, pose and map out. All thinking is in `processing.dpslam`.

A scan and its motion belong together by their stamp. Motions wait in order, and nothing is dropped while the
mapper keeps up; where it does not, whole scans are left out, newest first to be served, and counted.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from processing import se2
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam, MapStep
from processing.dpslam.resume import Returning
from processing.motion import Motion, following
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Scan
from runtime import messages
from runtime.formats.map_server import GridMap
from runtime.messages import BadMessageError
from runtime.nodes.convert import (
    motion_from_message,
    pose_to_message,
    scan_from_message,
    transform_to_message,
)
from runtime.nodes.live_session import LiveSession, Mapper, shown
from runtime.nodes.map_teller import MapTeller
from runtime.nodes.matcher import rehearsal
from runtime.nodes.rows import KEYS_COLUMNS, KEYS_FILE, Rows, write_particles
from runtime.nodes.saved import places_in_words
from runtime.port import Level, Port, Subscription
from runtime.process.checkpoint import Checkpoint
from runtime.reports.results import RunResult, provenance, save

SUBSCRIBES: tuple[str, ...] = ("scan", "odom")
PUBLISHES: tuple[str, ...] = ("pose", "map", "map_updates", "particles", "trajectory", "tf")

_WAIT_S = 0.1
_SCAN_WAIT_S = 0.05
KEEP_SCANS = 64
"""As many scans as motions may wait, so that each motion still finds its scan."""
LATE_SCANS = 20
"""Motions waiting from which on scans are left out: two seconds behind the laser."""
CHECKPOINT_NS = 2_000_000_000
"""So much of the drive at most is missing in the map of a mapper that was killed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The mapper; nothing of it has to be set to get a map."""

    mapping: DpSlamConfig = field(default_factory=DpSlamConfig)
    map_period_s: float = 1.0
    """The map is published so often at most, and only when it has changed."""
    session: str = ""
    """A saved map on which the drive begins, anywhere: session file or results folder; empty for none."""
    extend: bool = False
    """Whether the drive is mapped onto it; else the map stays as it is and the laser is followed on it."""

    def __post_init__(self) -> None:
        if not 0.1 <= self.map_period_s <= 60.0:
            raise ValueError(f"map_period_s = {self.map_period_s}, must be in [0.1, 60]")
        if self.extend and not self.session:
            raise ValueError("extend = True, must be False without a session")


def run(port: Port, config: Config) -> int:
    """Work scan by scan until the port stops; then write the results."""
    warm_up(config.mapping)
    mapper = _Mapper(port, config)
    scans = port.subscribe("scan", keep=KEEP_SCANS)
    motions = port.subscribe("odom")
    pairs = Pairs(port, scans, motions)
    port.ready()
    while not port.stopping:
        pair = pairs.next()
        if pair is not None:
            mapper.take(*pair)
        mapper.tell()
        mapper.keep()
    port.report("ok", "saving the map")
    mapper.save()
    return 0


class Pairs:
    """Brings scans and motions of one stamp together, in the order of the motions."""

    def __init__(self, port: Port, scans: Subscription, motions: Subscription) -> None:
        self._port, self._scans, self._motions = port, scans, motions
        self._waiting: dict[int, Scan] = {}
        self._left_out: Motion | None = None
        self._queue: list[Motion] = []

    def next(self) -> tuple[Scan, Motion] | None:
        """Return the next scan with its motion; None if there is none within a tenth of a second."""
        motion = self._next_motion()
        if motion is None:
            return None
        if len(self._queue) >= LATE_SCANS:
            self._port.count("scans_too_late")
            self._leave_out(motion)
            return None
        scan = self._scan_of(motion.stamp_ns)
        if scan is None:
            self._port.count("motions_without_scan")
            self._leave_out(motion)
            return None
        if self._left_out is not None:
            motion, self._left_out = following(self._left_out, motion), None
        return scan, motion

    def _leave_out(self, motion: Motion) -> None:
        self._left_out = motion if self._left_out is None else following(self._left_out, motion)

    def _next_motion(self) -> Motion | None:
        if not self._queue:
            received = self._motions.wait(_WAIT_S)
            if received is None:
                return None
            self._queue.append(motion_from_message(received.message))
        self._queue += [motion_from_message(more.message) for more in self._motions.drain()]
        return self._queue.pop(0)

    def _scan_of(self, stamp_ns: int) -> Scan | None:
        for received in self._scans.drain():
            self._keep(received.message)
        while stamp_ns not in self._waiting:
            arrival = self._scans.wait(_SCAN_WAIT_S)
            if arrival is None:
                return None
            self._keep(arrival.message)
        scan = self._waiting.pop(stamp_ns)
        for older in [stamp for stamp in self._waiting if stamp < stamp_ns]:
            del self._waiting[older]
        return scan

    def _keep(self, message: Any) -> None:
        try:
            scan = scan_from_message(message)
        except BadMessageError:
            self._port.count("refused_scans")
            return
        self._waiting[scan.stamp_ns] = scan
        while len(self._waiting) > KEEP_SCANS:
            del self._waiting[next(iter(self._waiting))]


class _Mapper:
    """What is between the filter and the port."""

    def __init__(self, port: Port, config: Config) -> None:
        self._port, self._config = port, config
        identity = (config.mapping, config.session, config.extend, port.seed)
        self._checkpoint = Checkpoint(port.run_dir / "mapper.checkpoint", CHECKPOINT_NS, identity)
        kept = self._checkpoint.read()
        earlier = kept[3] if kept else ()
        self._session = LiveSession(port, config.session, config.extend, config.mapping, earlier)
        self._filter: Mapper
        self._scans: int
        self._stamp_ns: int
        self._filter, self._scans, self._stamp_ns = kept[:3] if kept else (self._session.mapper(), 0, 0)
        self._resumed = kept is not None
        if self._resumed:
            port.count("resumptions")
            port.log.warning("goes on with the map of the process before it, %d scans", self._scans)
        self._map_mb = 0.0
        self._keys = Rows(port.results_dir, KEYS_FILE, KEYS_COLUMNS)
        self._teller = MapTeller(port, config.map_period_s)
        # What the process before it had published went with it; and a saved map is shown at once.
        self._teller.changed = self._resumed or self._session.begins_on_map

    def take(self, scan: Scan, motion: Motion) -> None:
        """Work one scan in and say where the laser is."""
        if self._resumed and not motion.lost and not motion.anew:
            motion, self._resumed = self._over_the_gap(scan, motion), False
        try:
            step = self._filter.step(scan, motion)
        except ValueError as error:
            self._port.count("refused_scans")
            self._port.report("error", f"scan refused: {error}")
            return
        self._session.add(scan)
        self._scans += 1
        self._stamp_ns = scan.stamp_ns
        self._teller.changed |= step.updated
        if step.updated:
            self._map_mb = round(self._filter.bytes_held / 1e6, 1)
            self._keys.add(scan.stamp_ns, f"{step.n_eff:.1f}", int(step.resampled))
        # Nobody shall drive by a pose on the map while the laser is not known to be there.
        if self._session.still_looking(self._filter, step):
            return
        if step.lost:
            level, text = _lost(step, motion)
            self._port.report(level, text, places=len(step.places), scans=self._scans)
        else:
            self._publish(step, motion)

    def _over_the_gap(self, scan: Scan, motion: Motion) -> Motion:
        """Give the first motion after a restart the doubt of those that nobody worked in."""
        steps = max(1, round((scan.stamp_ns - self._stamp_ns) / (scan.beams.period_s * 1e9)))
        return replace(motion, covariance=steps * motion.covariance)

    def keep(self) -> None:
        """Write down what the next process needs if this one is killed, now and then, after the answers."""
        if not self._scans or not self._checkpoint.due(self._stamp_ns):
            return
        state = (self._filter, self._scans, self._stamp_ns, self._session.kept())
        if not self._checkpoint.write(self._stamp_ns, state):
            self._port.count("checkpoints_failed")

    def _publish(self, step: MapStep, motion: Motion) -> None:
        port, stamp_ns = self._port, motion.stamp_ns
        spread = _spread(step)
        pose = messages.PoseWithCovariance(pose=pose_to_message(step.map_t_laser), covariance=spread)
        header = messages.header(stamp_ns, "map")
        port.publish("pose", messages.PoseWithCovarianceStamped(header=header, pose=pose))
        map_t_odom = se2.compose(step.map_t_laser, se2.invert(motion.odom_t_laser))
        placed = transform_to_message(stamp_ns, "map", "odom", map_t_odom)
        port.publish("tf", messages.TFMessage(transforms=[placed]))
        if step.updated:
            poses = [pose_to_message(particle) for particle in step.particles]
            port.publish("particles", messages.PoseArray(header=header, poses=poses))
        port.report(
            "ok",
            "mapping",
            particles=len(step.particles),
            n_eff=round(step.n_eff, 1),
            scans=self._scans,
            map_size=self._teller.size,
            map_mb=self._map_mb,
        )

    def tell(self) -> None:
        """Publish map and trajectory, if they changed and it is time."""
        self._teller.tell(shown(self._filter), self._stamp_ns)

    def save(self) -> None:
        """Write the results folder of this run, if anybody wants one and there is something in it."""
        if self._port.results_dir is None or not self._scans:
            return
        with self._keys:
            write_particles(self._port.results_dir, self._filter.population)
        self._filter.finish()
        first = self._filter.first_scan if isinstance(self._filter, Returning) else 0
        stamps_ns, trajectory = self._filter.trajectory()
        stamps_ns, trajectory = stamps_ns[first:], trajectory[first:]
        occupancy = self._filter.occupancy()
        session, keep_out = self._session.leave(self._filter, occupancy)
        steps = np.diff(trajectory[:, :2], axis=0)
        grid = GridMap(occupancy.probability, occupancy.resolution_m, occupancy.origin_m)
        known = np.count_nonzero(~np.isnan(grid.probability)) * grid.resolution_m**2
        result = RunResult(
            config=self._config,
            stamps_ns=np.asarray(stamps_ns, dtype=np.int64),
            trajectory=trajectory,
            odometry=self._filter.odometry()[first:],
            grid=grid,
            path_m=trajectory[:, :2],
            metrics={
                "scans": len(trajectory),
                "way_m": float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
                "known_m2": float(known),
                "resolution_m": grid.resolution_m,
            },
            run=provenance(self._port.seed) | {"frame": "laser"} | dict(self._session.about(self._filter)),
            session=session,
            keep_out=keep_out,
            caption=f"{self._port.robot}, {len(trajectory)} scans, laser alone",
        )
        save(self._port.results_dir, result)


def _lost(step: MapStep, motion: Motion) -> tuple[Level, str]:
    """Say what is wrong, and what to do."""
    if motion.lost:
        return "warn", "the matcher has lost the laser; the map waits, and nothing is written"
    if len(step.places) > 1:
        places = places_in_words(step.places)
        return "error", f"lost: {len(step.places)} places of the map fit equally: {places}; drive on"
    return "error", "lost: looking for the laser on the map; drive slowly to where the map is known"


def _spread(step: MapStep) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the covariance (36,) of the particles about the best one, map axes, as ROS lays it out."""
    last = step.particles[int(np.argmax(step.weights))]
    off = step.particles - last
    off[:, 2] = se2.wrap(off[:, 2])
    planar = (off * step.weights[:, None]).T @ off
    full = np.zeros((6, 6))
    full[np.ix_((0, 1, 5), (0, 1, 5))] = planar
    return full.ravel()


def warm_up(config: DpSlamConfig) -> None:
    """Run every compiled loop once, so that the robot's first scan is not the one that waits."""
    odometry, mapper = LaserOdometry(OdometryConfig(), 0), DpSlam(config, 0)
    for scan in rehearsal(4):
        mapper.step(scan, odometry.step(scan).motion)
    mapper.trajectory()
    mapper.occupancy()
