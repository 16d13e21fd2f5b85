"""Matcher process: scans in, laser odometry out. All thinking is in `processing.odometry`."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from processing.odometry import LaserOdometry, Match, OdometryConfig, Tracking
from processing.scan import Beams, Scan
from runtime import messages
from runtime.messages import BadMessageError
from runtime.nodes import mounting
from runtime.nodes.convert import motion_to_message, scan_from_message
from runtime.nodes.missed import Missed
from runtime.nodes.rows import MATCH_COLUMNS, MATCH_FILE, Rows
from runtime.port import Level, Port, Received
from runtime.process.checkpoint import Checkpoint
from runtime.topics import topic

SUBSCRIBES: tuple[str, ...] = ("scan",)
PUBLISHES: tuple[str, ...] = ("odom", "match_points", "tf", "tf_static")

_WAIT_S = 0.1
KEEP_SCANS = 3
"""After a stall of the machine scans come in a burst; each is worked in as long as that is quick."""
MOUNTED_NS = 1_000_000_000
"""How often it is said where the laser sits: not every client asks for what was said before it came."""
CHECKPOINT_NS = 500_000_000
"""So much at most is forgotten when the process is killed; the next one has its local map and its frame."""
BLIND_NS = 500_000_000
"""Who has not seen one direction for so long is told what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """The laser odometry; nothing of it has to be set to get a map."""

    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    laser_in_base: mounting.LaserInBase | None = None
    """Mounting of the laser: x, y (m) and yaw (rad) in the robot's frame; `tf` then has `base_link`, too."""

    def __post_init__(self) -> None:
        if not mounting.is_possible(self.laser_in_base):
            raise ValueError(f"laser_in_base = {self.laser_in_base}, must be three finite numbers")


def run(port: Port, config: Config) -> int:
    """Answer every scan with a motion until the port stops."""
    warm_up(config.odometry)
    checkpoint = Checkpoint(port.run_dir / "matcher.checkpoint", CHECKPOINT_NS, (config, port.seed))
    kept = checkpoint.read()
    if kept is not None:
        port.count("resumptions")
        port.log.warning("goes on where the process before it was killed")
    odometry, missed = kept or (LaserOdometry(config.odometry, port.seed), Missed())
    scans, teller = Scans(port), Teller(port, config.laser_in_base)
    with Rows(port.results_dir, MATCH_FILE, MATCH_COLUMNS) as rows:
        port.ready()
        mounted_ns: int | None = None
        while not port.stopping:
            received = scans.next()
            if received is None:
                continue
            try:
                scan = scan_from_message(received.message)
                period_s = scan.beams.period_s
                before = missed.before(received.gid, received.sequence, scan.stamp_ns, period_s)
                match = odometry.step(scan, before)
            except (BadMessageError, ValueError) as error:
                port.count("refused_scans")
                port.report("error", f"scan refused: {error}")
                continue
            teller.tell(match)
            if config.laser_in_base is not None and (
                mounted_ns is None or not 0 <= scan.stamp_ns - mounted_ns < MOUNTED_NS
            ):
                mounted_ns = scan.stamp_ns
                port.publish("tf_static", mounting.tf_static(mounted_ns, config.laser_in_base))
            # After the answer is out: nobody waits for this.
            _note(rows, match)
            if checkpoint.due(scan.stamp_ns) and not checkpoint.write(scan.stamp_ns, (odometry, missed)):
                port.count("checkpoints_failed")
    return 0


def _note(rows: Rows, match: Match) -> None:
    variances = np.linalg.eigvalsh(match.motion.covariance[:2, :2])
    best_mm, worst_mm = 1e3 * np.sqrt(np.maximum(variances, 0.0))
    if match.motion.lost or match.motion.anew:
        best_mm = worst_mm = np.nan
    quality = (f"{match.score:.3f}", len(match.points_laser), f"{best_mm:.2f}", f"{worst_mm:.2f}")
    rows.add(match.motion.stamp_ns, match.state.name, *quality)


class Scans:
    """The scans in their order; but the newest alone where the matcher does not keep up with the laser."""

    def __init__(self, port: Port) -> None:
        self._port, self._scans = port, port.subscribe("scan", keep=KEEP_SCANS)
        self._given_ns: int | None = None
        self._slow = 0  # times in a row that the work on a scan took longer than the laser for the next

    def next(self) -> Received | None:
        """Return the next scan; None if there is none within a tenth of a second."""
        if self._given_ns is not None:
            took_ns = self._port.clock.now_ns() - self._given_ns
            self._slow = self._slow + 1 if took_ns > topic("scan").period_ns else 0
        # Once is a stall of the machine, and what came meanwhile is worked in quickly.
        waiting = self._scans.drain() if self._slow > 1 else []
        if waiting:
            self._port.count("scans_skipped", len(waiting) - 1)
        received = waiting[-1] if waiting else self._scans.wait(_WAIT_S)
        self._given_ns = None if received is None else self._port.clock.now_ns()
        return received


class Teller:
    """Sends motions, the points that they rest on, and in words how far they are to be believed.

    That one direction is not seen for a moment, as between two doors of a corridor, asks nothing of anybody:
    the state says so at once, and the warning waits.
    """

    def __init__(self, port: Port, laser_in_base: mounting.LaserInBase | None = None) -> None:
        self._port, self._laser_in_base = port, laser_in_base
        self._blind_since_ns: int | None = None

    def tell(self, match: Match) -> None:
        """Publish one match."""
        port, motion = self._port, match.motion
        port.publish("odom", motion_to_message(motion))
        port.publish("match_points", cloud(motion.stamp_ns, match.points_laser))
        port.publish("tf", mounting.tf(motion.stamp_ns, motion.odom_t_laser, self._laser_in_base))
        state = match.state.name
        if match.blind_rad is not None:
            state += f" ({round(float(np.degrees(match.blind_rad)))} deg)"
        level, text = self._words(match)
        port.report(level, text, state=state, score=round(match.score, 3), points=len(match.points_laser))

    def _words(self, match: Match) -> tuple[Level, str]:
        stamp_ns = match.motion.stamp_ns
        if match.state is not Tracking.DEGENERATE:
            self._blind_since_ns = None
        if match.state is Tracking.LOST:
            return (
                "error",
                "lost: the scan fits nowhere near; hold the laser still, or bring it back to where it was",
            )
        if match.state is Tracking.TRACKING:
            return "ok", "tracking"
        if self._blind_since_ns is None or stamp_ns < self._blind_since_ns:
            self._blind_since_ns = stamp_ns
        if stamp_ns - self._blind_since_ns < BLIND_NS:
            return "ok", "tracking; one direction is not seen for a moment"
        return "warn", (
            "one direction is not seen, the motion is taken to go on along it; keep your speed to a corner"
        )


def cloud(stamp_ns: int, points_laser: NDArray[np.float64]) -> messages.PointCloud2:
    """Return the points (N, 2) as a PointCloud2 of x, y, z in single precision."""
    points = np.zeros((len(points_laser), 3), dtype=np.float32)
    points[:, :2] = points_laser
    real = 7  # PointField.FLOAT32
    fields = [
        messages.PointField(name=name, offset=4 * k, datatype=real, count=1) for k, name in enumerate("xyz")
    ]
    return messages.PointCloud2(
        header=messages.header(stamp_ns, "laser"),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(points),
        data=points.view(np.uint8).reshape(-1),
        is_dense=True,
    )


def warm_up(config: OdometryConfig) -> None:
    """Run every compiled loop once, so that the robot's first scan is not the one that waits."""
    odometry = LaserOdometry(config, 0)
    for scan in rehearsal(4):
        odometry.step(scan)


def rehearsal(count: int) -> list[Scan]:
    """Return scans of a small room as a URG-04LX would see it while it drives through."""
    beams = Beams(
        count=682,
        angle_min_rad=-2.0862,
        angle_increment_rad=2 * np.pi / 1024,
        time_increment_s=0.1 / 1024,
        range_max_m=5.6,
    )
    c, s = np.cos(beams.bearings()), np.sin(beams.bearings())
    scans = []
    for k in range(count):
        x, y = -1.0 + 0.3 * k, 0.2
        with np.errstate(divide="ignore"):
            across = np.where(c > 0, (2.0 - x) / c, (-2.0 - x) / c)
            along = np.where(s > 0, (1.5 - y) / s, (-1.5 - y) / s)
        ranges = np.minimum(across, along).astype(np.float32)
        scans.append(Scan(1_000_000_000 + 100_000_000 * k, ranges, beams))
    return scans
