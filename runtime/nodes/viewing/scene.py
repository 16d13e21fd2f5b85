"""From messages to a picture: which sweep belongs at which pose, what changed, what is drawn how often.

Law: bounded rates and sizes, whatever arrives. Everything is drawn through `paint(kind, draw)`, which may
drop a drawing in favour of a newer one of its kind.
"""

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from processing.motion import Motion
from processing.scan import Scan, end_points
from processing.se2 import Pose, compose, transform
from runtime import messages
from runtime.messages import BadMessageError
from runtime.nodes.convert import motion_from_message, pose_from_message, scan_from_message
from runtime.nodes.viewing.shapes import cloud_points, outline, shrunk, unseen
from runtime.nodes.viewing.words import BUMPS, STARTING, Base, words_of
from runtime.port import Received
from runtime.process.health import LEVELS, Vital, make_room
from runtime.process.status import MATCHER, status_of

Points = NDArray[np.float64]

SUBSCRIBES = (
    "scan",
    "odom",
    "match_points",
    "pose",
    "map",
    "map_updates",
    "particles",
    "trajectory",
    "tf",
    "battery",
    "bumper",
    "diagnostics",
)
PERIODS_NS = {
    "scan": 90_000_000,
    "uncertainty": 90_000_000,
    "path": 500_000_000,
    "particles": 500_000_000,
    "map": 2_000_000_000,
    "state": 500_000_000,
    "rates": 1_000_000_000,
    "latency": 200_000_000,
}
"""Time between two drawings of a kind, at least."""
MAP_CELLS_MAX = 1_000_000
PATH_POINTS_MAX = 4_000
SWEEPS_HELD = 8
NODES_MAX = 64


class Canvas(Protocol):
    """What the scene draws on; see `viewing.screen.Screen`."""

    def at(self, stamp_ns: int) -> None: ...  # noqa: D102
    def grid(self, cells: NDArray[np.int8], resolution_m: float, origin_m: tuple[float, float]) -> None: ...  # noqa: D102
    def scan(self, rays: Points, hits: Points) -> None: ...  # noqa: D102
    def laser(self, map_t_laser: Pose) -> None: ...  # noqa: D102
    def uncertainty(self, ellipse: Points, blind: Points) -> None: ...  # noqa: D102
    def path(self, points: Points) -> None: ...  # noqa: D102
    def particles(self, poses: Points) -> None: ...  # noqa: D102
    def number(self, path: str, value: float) -> None: ...  # noqa: D102
    def state(self, path: str, word: str) -> None: ...  # noqa: D102
    def words(self, markdown: str) -> None: ...  # noqa: D102
    def note(self, level: str, text: str) -> None: ...  # noqa: D102


Paint = Callable[[str, Callable[[Canvas], None]], None]


@dataclass(slots=True, eq=False)
class _Sweep:
    """What has arrived of one scan."""

    scan: Scan | None = None
    motion: Motion | None = None
    used_laser: Points | None = None

    @property
    def complete(self) -> bool:
        return self.scan is not None and self.motion is not None and self.used_laser is not None


class Scene:
    """Takes messages in the order of their arrival and paints what they say.

    Args:
        robot: Whose diagnostics count.
        paint: Draws now, later, or not at all.
        drawn: Told the stamp of each sweep, ns, once it is drawn; from where drawing is done.
    """

    def __init__(
        self, robot: str, paint: Paint, drawn: Callable[[int], None] = lambda stamp_ns: None
    ) -> None:
        self._robot, self._paint, self._drawn = robot, paint, drawn
        self._drawn_ns: dict[str, int] = {}
        self._now_ns = 0
        self._sweeps: OrderedDict[int, _Sweep] = OrderedDict()
        self._map_t_odom: Pose = np.zeros(3)
        self._path: list[Points] = []
        self._pose: tuple[Pose, NDArray[np.float64]] | None = None
        self._grid: tuple[NDArray[np.int8], float, tuple[float, float]] | None = None
        self._vitals: dict[str, Vital] = {}
        self._base = Base()
        self._tracking = ""
        self._notes = 0
        self.refused = 0
        """Messages that described nothing that can be drawn."""

    def take(self, received: Received) -> None:
        """Take the next message in."""
        handle = getattr(self, f"_on_{received.topic}", None)
        if handle is None:
            return
        self._now_ns = max(self._now_ns, received.published_ns or received.received_ns)
        try:
            handle(received.message, received)
        except (BadMessageError, ValueError, IndexError):
            self.refused += 1

    def again(self) -> None:
        """Paint everything that changes seldom once more, for those who came late."""
        self._drawn_ns.clear()
        self._paint_map(self._now_ns)
        self._paint_path(self._now_ns)
        self._paint_state()

    # ---- one method for each topic ----

    def _on_scan(self, message: Any, received: Received) -> None:
        scan = scan_from_message(message)
        self._sweep(scan.stamp_ns).scan = scan
        self._paint_sweep(scan.stamp_ns)

    def _on_match_points(self, message: Any, received: Received) -> None:
        stamp_ns = messages.stamp_ns_of(message.header.stamp)
        self._sweep(stamp_ns).used_laser = cloud_points(message)
        self._paint_sweep(stamp_ns)

    def _on_odom(self, message: Any, received: Received) -> None:
        motion = motion_from_message(message)
        self._sweep(motion.stamp_ns).motion = motion
        # The points of an earlier scan will not come any more: draw it without them.
        for stamp_ns in [s for s in self._sweeps if s < motion.stamp_ns]:
            self._paint_sweep(stamp_ns, even_incomplete=True)
        self._paint_sweep(motion.stamp_ns)

    def _on_pose(self, message: Any, received: Received) -> None:
        stamp_ns = messages.stamp_ns_of(message.header.stamp)
        pose = pose_from_message(message.pose.pose)
        covariance = np.array(message.pose.covariance, dtype=np.float64).reshape(6, 6)[:2, :2]
        self._pose = (pose, covariance)
        self._path.append(pose[:2])
        if received.published_ns and self._due("latency", stamp_ns):
            self._paint_age("scan_to_pose", stamp_ns, received.published_ns)
        self._paint_path(stamp_ns)

    def _on_map(self, message: Any, received: Received) -> None:
        info = message.info
        cells = np.array(message.data, dtype=np.int8).reshape(info.height, info.width)
        if not info.resolution > 0.0:
            raise ValueError(f"resolution = {info.resolution}, must be positive")
        origin = (float(info.origin.position.x), float(info.origin.position.y))
        self._grid = (cells, float(info.resolution), origin)
        stamp_ns = messages.stamp_ns_of(message.header.stamp)
        if received.published_ns:
            self._paint_age("scan_to_map", stamp_ns, received.published_ns)
        self._paint_map(stamp_ns)

    def _on_map_updates(self, message: Any, received: Received) -> None:
        if self._grid is None:
            return
        cells = self._grid[0]
        rows = slice(message.y, message.y + message.height)
        cols = slice(message.x, message.x + message.width)
        if min(message.x, message.y) < 0 or rows.stop > cells.shape[0] or cols.stop > cells.shape[1]:
            raise ValueError("an update outside the map")
        cells[rows, cols] = np.asarray(message.data, dtype=np.int8).reshape(message.height, message.width)
        self._paint_map(messages.stamp_ns_of(message.header.stamp))

    def _on_particles(self, message: Any, received: Received) -> None:
        stamp_ns = messages.stamp_ns_of(message.header.stamp)
        if not self._due("particles", stamp_ns):
            return
        poses = np.array([pose_from_message(pose) for pose in message.poses]).reshape(-1, 3)
        self._at("particles", stamp_ns, lambda c: c.particles(poses))

    def _on_trajectory(self, message: Any, received: Received) -> None:
        poses = message.poses
        every = max(1, -(-len(poses) // PATH_POINTS_MAX))
        # From the end backwards, so that the newest pose stays.
        kept = poses[::-1][::every][::-1]
        self._path = [np.array((p.pose.position.x, p.pose.position.y)) for p in kept]
        self._paint_path(messages.stamp_ns_of(message.header.stamp))

    def _on_tf(self, message: Any, received: Received) -> None:
        for transform_ in message.transforms:
            if (transform_.header.frame_id, transform_.child_frame_id) == ("map", "odom"):
                t, q = transform_.transform.translation, transform_.transform.rotation
                self._map_t_odom = np.array((t.x, t.y, 2.0 * np.arctan2(q.z, q.w)))

    def _on_battery(self, message: Any, received: Received) -> None:
        percent = 100.0 * float(message.percentage)
        if np.isfinite(percent):
            self._base.battery_percent = percent
            self._at("battery", self._now_ns, lambda c: c.number("base/battery", percent))

    def _on_bumper(self, message: Any, received: Received) -> None:
        word = BUMPS[min(2, bool(message.data & 0x03) + 2 * bool(message.data & 0x1C))]
        if word == self._base.bumper:
            return
        self._base.bumper = word
        self._at(f"bumper {self._notes}", self._now_ns, lambda c: c.state("state/bumper", word))
        if word != BUMPS[0]:
            self._note("warn", f"base: {word}")

    def _on_diagnostics(self, message: Any, received: Received) -> None:
        for status in message.status:
            robot, _, name = status.name.partition("/")
            if robot != self._robot:
                continue
            if name not in self._vitals and len(self._vitals) >= NODES_MAX:
                make_room(self._vitals)
            if name not in self._vitals and len(self._vitals) >= NODES_MAX:
                continue
            level = LEVELS[min(status.level, 3)]
            before = self._vitals.get(name)
            if level != (before.level if before else "ok"):
                self._note(level, f"{name}: {status.message}")
            values = {pair.key: pair.value for pair in status.values}
            stamp_ns = messages.stamp_ns_of(message.header.stamp)
            self._vitals[name] = Vital(name, level, status.message, values, stamp_ns, time.monotonic())
        self._paint_state()

    # ---- drawing ----

    def _paint_sweep(self, stamp_ns: int, *, even_incomplete: bool = False) -> None:
        sweep = self._sweeps[stamp_ns]
        if not (sweep.complete or even_incomplete):
            return
        del self._sweeps[stamp_ns]
        scan, motion = sweep.scan, sweep.motion
        if scan is None or motion is None or not self._due("scan", stamp_ns):
            return
        map_t_laser = compose(self._map_t_odom, motion.odom_t_laser)
        rays = transform(map_t_laser, end_points(scan, motion.twist)[0])
        used = sweep.used_laser if sweep.used_laser is not None else np.zeros((0, 2))
        hits = transform(map_t_laser, used)
        ellipse = outline(*self._pose) if self._pose is not None else np.zeros((0, 2))
        blind = np.zeros((0, 2))
        if self._tracking == "DEGENERATE":
            blind = unseen(map_t_laser, motion.covariance)

        def draw(canvas: Canvas) -> None:
            canvas.scan(rays, hits)
            canvas.laser(map_t_laser)
            canvas.uncertainty(ellipse, blind)
            self._drawn(stamp_ns)

        self._at("scan", stamp_ns, draw)

    def _paint_age(self, name: str, stamp_ns: int, published_ns: int) -> None:
        age_ms = round((published_ns - stamp_ns) / 1e6, 1)
        self._at(f"age {name}", stamp_ns, lambda c: c.number(f"latency/{name}", age_ms))

    def _paint_path(self, stamp_ns: int) -> None:
        if len(self._path) > 2 * PATH_POINTS_MAX:
            self._path = self._path[::-1][::2][::-1]
        if self._path and self._due("path", stamp_ns):
            points = np.array(self._path).reshape(-1, 2)
            self._at("path", stamp_ns, lambda c: c.path(points))

    def _paint_map(self, stamp_ns: int) -> None:
        if self._grid is None or not self._due("map", stamp_ns):
            return
        cells, resolution_m, origin_m = self._grid
        shrink = int(np.ceil(np.sqrt(cells.size / MAP_CELLS_MAX)))
        small = shrunk(cells, shrink)
        self._at("map", stamp_ns, lambda c: c.grid(small, resolution_m * shrink, origin_m))

    def _paint_state(self) -> None:
        stamp_ns = self._now_ns
        status = status_of(self._robot, self._vitals)
        word = status.tracking.partition(" ")[0] or STARTING
        if word != self._tracking:
            self._tracking = word
            self._at(f"tracking {self._notes}", stamp_ns, lambda c: c.state("state/tracking", word))
            self._notes += 1
        if self._due("rates", stamp_ns) and status.rates_hz:
            wanted = ("scan", "odom", "pose")
            rates = {name: hz for name, hz in status.rates_hz.items() if name in wanted}
            self._at("rates", stamp_ns, lambda c: _numbers(c, "rate", rates))
        if self._due("state", stamp_ns):
            matcher = self._vitals.get(MATCHER)
            text = words_of(status, self._base, matcher.text if matcher else "")
            self._at("words", stamp_ns, lambda c: c.words(text))

    def _note(self, level: str, text: str) -> None:
        self._notes += 1
        self._at(f"note {self._notes}", self._now_ns, lambda c: c.note(level, text))

    def _at(self, kind: str, stamp_ns: int, draw: Callable[[Any], None]) -> None:
        def at_its_time(canvas: Canvas) -> None:
            canvas.at(stamp_ns)
            draw(canvas)

        self._paint(kind, at_its_time)

    def _due(self, kind: str, stamp_ns: int) -> bool:
        """Whether a kind may be drawn again; a stamp from before the last drawing may, too."""
        last = self._drawn_ns.get(kind)
        if last is not None and 0 <= stamp_ns - last < PERIODS_NS[kind]:
            return False
        self._drawn_ns[kind] = stamp_ns
        return True

    def _sweep(self, stamp_ns: int) -> _Sweep:
        sweep = self._sweeps.setdefault(stamp_ns, _Sweep())
        while len(self._sweeps) > SWEEPS_HELD:
            self._sweeps.popitem(last=False)
        return sweep


def _numbers(canvas: Canvas, origin: str, values: dict[str, float]) -> None:
    for name, value in values.items():
        canvas.number(f"{origin}/{name}", value)
