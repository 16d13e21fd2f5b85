"""What the mapper says of its map, how often, and in which pieces.

The whole map is large and goes out when it grows or has not gone out for long; in between go the parts that
have changed. Guests on other machines get neither: they ask for tiles.
"""

from processing.dpslam.filter import DpSlam
from processing.dpslam.resume import Returning
from runtime import messages
from runtime.bus.pulling import grid_message
from runtime.nodes.convert import pose_to_message
from runtime.port import Port
from runtime.tiles import Tiles

PATH_POSES = 400
"""Of the published trajectory at most: two batches of a slow link, which hold it without a wait."""
WHOLE_NS = 10_000_000_000
"""Whoever comes late and listens to the topics has the present map after so long."""
PATH_NS = 5_000_000_000
"""In between, the poses lengthen it for whoever has it."""
GUESTS_BYTES_PER_S = 250_000
"""Of the map, to all guests together."""


class MapTeller:
    """Publishes map, changes and trajectory, and answers guests."""

    def __init__(self, port: Port, period_s: float) -> None:
        self._port, self._period_ns = port, round(period_s * 1e9)
        self._tiles = Tiles(GUESTS_BYTES_PER_S)
        self._told_ns = 0
        self._whole_ns: int | None = None
        self._behind = False  # the whole map that was published lacks the newest changes
        self._path_behind = False
        self._path_ns: int | None = None
        self.changed = False
        """Whether there is something to tell."""
        self.size = ""
        """Of what is known, in words."""
        port.answer("map", self._tiles.answer)

    def tell(self, mapping: DpSlam | Returning, stamp_ns: int) -> None:
        """Publish what is due; `stamp_ns` is that of the last scan worked in."""
        now_ns = self._port.clock.now_ns()
        if self.changed and now_ns - self._told_ns >= self._period_ns:
            self.changed, self._told_ns = False, now_ns
            self._map(mapping, stamp_ns, now_ns)
            self._path_behind = True
        elif self._behind and self._whole_is_old(now_ns):
            self._whole(now_ns)
        if self._path_behind and (self._path_ns is None or now_ns - self._path_ns >= PATH_NS):
            self._path_behind, self._path_ns = False, now_ns
            self._path(mapping, stamp_ns)

    def _map(self, mapping: DpSlam | Returning, stamp_ns: int, now_ns: int) -> None:
        grid = mapping.occupancy()
        rows, cols = grid.probability.shape
        self.size = f"{cols * grid.resolution_m:.1f} m x {rows * grid.resolution_m:.1f} m"
        grown, parts = self._tiles.take(grid.percent(), grid.resolution_m, grid.origin_m, stamp_ns, now_ns)
        if grown or self._whole_is_old(now_ns):
            self._whole(now_ns)
            return
        header, cells = messages.header(stamp_ns, "map"), self._tiles.picture.cells
        for part in parts:
            self._behind = True
            update = messages.OccupancyGridUpdate(
                header=header,
                x=part.x,
                y=part.y,
                width=part.width,
                height=part.height,
                data=cells[part.y : part.y + part.height, part.x : part.x + part.width].reshape(-1),
            )
            self._port.publish("map_updates", update)

    def _whole_is_old(self, now_ns: int) -> bool:
        return self._whole_ns is None or now_ns - self._whole_ns >= WHOLE_NS

    def _whole(self, now_ns: int) -> None:
        self._whole_ns, self._behind = now_ns, False
        self._port.publish("map", grid_message(self._tiles.picture))

    def _path(self, mapping: DpSlam | Returning, stamp_ns: int) -> None:
        stamps_ns, path = mapping.trajectory(PATH_POSES)
        poses = [
            messages.PoseStamped(header=messages.header(stamp, "map"), pose=pose_to_message(pose))
            for stamp, pose in zip(stamps_ns.tolist(), path, strict=True)
        ]
        self._port.publish("trajectory", messages.Path(header=messages.header(stamp_ns, "map"), poses=poses))
