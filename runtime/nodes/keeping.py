"""The last minutes, kept when somebody on the bus asks for it: what happened just now is not yet gone."""

import logging
import threading
import time
from pathlib import Path

from runtime.bus.contract import Bus
from runtime.bus.offset import question_key
from runtime.recordings.recovery import keep_ring

QUESTION = "keep"
_ASK_S = 2.0
_JOIN_S = 1.0


def ask_to_keep(bus: Bus, robot: str) -> list[str]:
    """Ask the recorders of a robot to keep their rings; return the folders, on their machine."""
    return [answer.decode() for answer in bus.ask(question_key(robot, QUESTION), timeout_s=_ASK_S)]


class RingKeeper:
    """Keeps a ring in a thread, so that neither the recorder nor the bus waits for it; one keeping at a time.

    Args:
        ring: See `keep_ring`.
        within_s: See `keep_ring`.
        log: Where it is said what was kept, or why it could not be.
    """

    def __init__(self, ring: Path, within_s: float, log: logging.Logger) -> None:
        self._ring, self._within_s, self._log = ring, within_s, log
        self._thread: threading.Thread | None = None
        self._folder = ring.parent

    def answer(self, asked: bytes) -> bytes:
        """Begin to keep, unless that is going on; return the folder."""
        del asked  # whoever asks names no folder: this may be somebody on another machine
        if self._thread is None or not self._thread.is_alive():
            at = time.strftime("%Y%m%d-%H%M%S")
            self._folder = self._ring.parent.with_name(f"{self._ring.parent.name}-kept-{at}").absolute()
            self._thread = threading.Thread(target=self._keep, args=(self._folder,), daemon=True)
            self._thread.start()
        return str(self._folder).encode()

    def close(self) -> None:
        """Wait a moment for what is kept now; the newest file of the ring is whole."""
        if self._thread is not None:
            self._thread.join(_JOIN_S)

    def _keep(self, folder: Path) -> None:
        try:
            files = keep_ring(self._ring, folder, self._within_s)
        except OSError as error:
            self._log.error("%s: the ring could not be kept: %s", folder, error.strerror or error)
        else:
            self._log.info("%s: %d files of the ring are kept", folder, len(files))
