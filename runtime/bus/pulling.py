"""The map for a guest on another machine: asked for tile by tile, at the pace of the link.

Nothing is sent that was not asked for, and one answer at a time is under way: the link that is slow slows its
own questions down, and what else comes over it waits for one small answer at most.
"""

import os
import threading
import time
from collections.abc import Callable

from runtime import messages
from runtime.bus.contract import Arrival, Bus
from runtime.bus.offset import question_key
from runtime.tiles import Mosaic, Picture
from runtime.topics import Urgency

ANSWER_BYTES = 12_000
"""0.1 s of a link of 1 Mbit/s, and in one piece on every link."""
BYTES_PER_S = 40_000
"""A third of such a link."""
EVERY_S = 1.0
"""Time between two pictures, and between two questions when there is nothing new."""
_PATIENCE_S = 3.0
_FIRST_AGAIN_S = 0.2


class Puller:
    """Asks for the map in a thread of its own, and delivers it as if it had come on the topic `map`.

    Args:
        bus: Of the guest.
        robot: Whose map.
        key: Of the topic `map`.
        deliver: Takes each picture, numbered as by a publisher.
    """

    def __init__(self, bus: Bus, robot: str, key: str, deliver: Callable[[Arrival], None]) -> None:
        self._bus, self._question_key, self._key, self._deliver = (
            bus,
            question_key(robot, "map"),
            key,
            deliver,
        )
        self._mosaic = Mosaic()
        self._gid, self._sequence = os.urandom(16), 0
        self._changed, self._delivered_s = False, 0.0
        self.bytes_received = 0
        self.answers_damaged = 0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="map tiles", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End, after the bus was closed: a thread within it at the end of the process would crash that."""
        self._closing.set()
        self._thread.join()

    def _work(self) -> None:
        pause_s = 0.0
        while not self._closing.wait(pause_s):
            began_s = time.monotonic()
            size = self._ask()
            took_s = time.monotonic() - began_s
            complete = self._mosaic.left == 0
            if self._changed and (complete or time.monotonic() - self._delivered_s >= EVERY_S):
                self._show()
            if size:
                pause_s = max(size / BYTES_PER_S, EVERY_S if complete else 0.0) - took_s
            else:
                pause_s = _FIRST_AGAIN_S - took_s
            pause_s = max(0.0, pause_s)

    def _ask(self) -> int:
        """Ask once; return the bytes that came."""
        question = self._mosaic.question(ANSWER_BYTES)
        answers = self._bus.ask(self._question_key, question, _PATIENCE_S, urgency=Urgency.BULK)
        for answer in answers:
            self.bytes_received += len(answer)
            try:
                self._changed |= self._mosaic.take(answer)
            except ValueError:
                self.answers_damaged += 1
        return sum(map(len, answers))

    def _show(self) -> None:
        picture = self._mosaic.picture()
        if picture is None:
            return
        self._changed, self._delivered_s = False, time.monotonic()
        self._sequence += 1
        attachment = messages.Attachment(self._sequence, picture.published_ns, self._gid)
        payload = messages.encode(grid_message(picture))
        self._deliver(Arrival(self._key, payload, attachment, time.monotonic_ns()))


def grid_message(picture: Picture) -> messages.OccupancyGrid:
    """Return a map as ROS has it."""
    header = messages.header(picture.stamp_ns, "map")
    rows, cols = picture.cells.shape
    x, y = picture.origin_m
    origin = messages.Pose(
        position=messages.Point(x=x, y=y, z=0.0),
        orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
    )
    info = messages.MapMetaData(
        map_load_time=header.stamp,
        resolution=picture.resolution_m,
        width=cols,
        height=rows,
        origin=origin,
    )
    return messages.OccupancyGrid(header=header, info=info, data=picture.cells.reshape(-1))
