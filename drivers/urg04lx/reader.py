"""A URG read by a thread of its own, so that nobody who uses its scans can hold up the line.

Law: the reader never waits for its consumer.  When the queue is full the oldest scan goes, and is counted;
otherwise the buffers of the operating system would become a delay line.
"""

import threading
from collections import deque
from types import TracebackType

from drivers.errors import DeviceError
from drivers.urg04lx.device import Urg
from drivers.urg04lx.events import Event, UrgScan

_JOIN_S = 5.0


class UrgReader:
    """Runs a device; use it as a context.

    Args:
        device: Nobody else uses it meanwhile.
        keep: Most scans that wait for the consumer.
    """

    def __init__(self, device: Urg, keep: int = 10) -> None:
        if keep < 1:
            raise ValueError(f"keep = {keep}, must be at least 1")
        self.device = device
        self.overwritten = 0
        """Scans that nobody took in time."""
        self._keep = keep
        self._events: deque[Event] = deque()
        self._scans = 0
        self._error: Exception | None = None
        self._ended = False
        self._changed = threading.Condition()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="urg-reader", daemon=True)

    def __enter__(self) -> "UrgReader":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop the sensor and give the port back; takes half a second at most."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_S)

    def read(self, timeout_s: float) -> Event | None:
        """Return the next event, waiting for it; None if there is none in time.

        Raises:
            DeviceError: The device gave up.
            ValueError: The sensor cannot do what is configured.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._events or self._error or self._ended, timeout_s)
            if self._events:
                event = self._events.popleft()
                self._scans -= isinstance(event, UrgScan)
                return event
            if self._error:
                raise self._error
            if self._ended and not self._stopping.is_set():
                raise RuntimeError("the thread that reads the sensor has ended; its traceback says why")
        return None

    def _run(self) -> None:
        events = self.device.events()
        try:
            for event in events:
                if event is not None:
                    self._put(event)
                if self._stopping.is_set():
                    break
        except (DeviceError, ValueError) as error:
            self._error = error
        finally:
            # Closing runs the device's own ending, here, where nothing else reads the line.
            events.close()
            with self._changed:
                self._ended = True
                self._changed.notify()

    def _put(self, event: Event) -> None:
        with self._changed:
            self._events.append(event)
            self._scans += isinstance(event, UrgScan)
            if self._scans > self._keep:
                oldest = next(i for i, waiting in enumerate(self._events) if isinstance(waiting, UrgScan))
                del self._events[oldest]
                self._scans -= 1
                self.overwritten += 1
            elif len(self._events) > 100 + self._keep:
                self._events.popleft()
            self._changed.notify()
