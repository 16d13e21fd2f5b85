"""A URG that keeps measuring: connects, streams, and comes back from whatever happens on the way.

The device is a generator of events.  It yields None at least every 50 ms while nothing happens; closing it
stops the sensor and gives the port back, at any moment, within half a second.
"""

import os
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator

import numpy as np

from drivers.errors import (
    DeviceError,
    PortBusyError,
    PortForbiddenError,
    PortMissingError,
    ProtocolError,
    SilentError,
    TransportError,
)
from drivers.ports import usb_ports
from drivers.transport import SerialStream
from drivers.urg04lx import connect
from drivers.urg04lx.clockmap import ClockMap, Sequence
from drivers.urg04lx.connect import Identity
from drivers.urg04lx.decoder import Decoder, Reply, ScanReply
from drivers.urg04lx.events import Connected, Event, Notice, UrgScan
from drivers.urg04lx.geometry import Sweep, to_ranges
from drivers.urg04lx.link import POLL_S, Link, Stream, Waiting
from drivers.urg04lx.protocol import LF, StreamRequest
from drivers.urg04lx.settings import UrgConfig
from drivers.urg04lx.watch import REOPEN_S, RESET_S, Remedy, Watch

USB_VENDOR, USB_PRODUCT = "15d1", "0000"
_BACK_OFF_S = (0.5, 1.0, 2.0, 5.0)
_READY_S = 10.0
"""After plugging in, a sensor may need this long until it answers."""
_FAULT_WAIT_S, _FAULT_TRIES, _FAULT_RETRY_S = 2.0, 5, 30.0
_STOP_S = 0.5


class Urg:
    """One URG-04LX.

    Args:
        config: What is wanted.
        now_ns: A steady clock; every stamp is in it, and every wait by it.
        sleep: Waits that many seconds of this clock, where there is no line to wait for.
        find: Lists the ports where the sensor may be; without it as configured, or by USB identity.
        open_stream: Opens one of them at a rate.
        patience_s: How long a port may be missing, forbidden or busy before the first connection; then it is
            an error. Once there was a connection the port is waited for, for ever.
    """

    def __init__(
        self,
        config: UrgConfig,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
        find: Callable[[], list[str]] | None = None,
        open_stream: Callable[[str, int], Stream] = SerialStream,
        patience_s: float = 3.0,
    ) -> None:
        self.config = config
        self.decoder = Decoder()
        self.clock = ClockMap(config.clock)
        self.sequence = Sequence(config.skip)
        self.counts: Counter[str] = Counter()
        """scans, restarts, resets, failures, faults, beyond, impossible, code_0 .. code_19."""
        self._now_ns, self._sleep = now_ns, sleep
        self._find = find or self._find_ports
        self._open_stream = open_stream
        self._patience_s = patience_s
        self._link: Link | None = None
        self._known: dict[str, Identity] = {}
        self._connected: Connected | None = None
        self._held: deque[ScanReply] = deque()
        self._failures = 0  # since the last good scan; a connection alone is no success
        self._faults = 0

    def events(self) -> Generator[Event | None, None, None]:
        """Run the sensor until the generator is closed.

        Raises:
            DeviceError: It cannot work as configured, now or ever: wrong model, no SCIP 2.0, other geometry
                than before, or no port within the patience.
            ValueError: The sensor cannot do what is configured.
        """
        began_ns = self._now_ns()
        try:
            while True:
                path = ""
                try:
                    path = self._pick()
                    yield from self._connect(path)
                    yield from self._stream()
                except DeviceError as error:
                    self._close()
                    yield self._judge(error, path, self._elapsed_s(began_ns))
                yield from self._pause(self._back_off_s())
        finally:
            self._close()

    # ---- connecting

    def _find_ports(self) -> list[str]:
        port = self.config.port
        if port == "auto" or (self._connected and not self.config.baud and not os.path.exists(port)):
            return [found.path for found in usb_ports(USB_VENDOR, USB_PRODUCT)]
        return [port]

    def _pick(self) -> str:
        """Choose among the ports where the sensor may be; with each failure another one."""
        paths = self._find()
        if not paths:
            raise PortMissingError(
                f"no URG on USB ({USB_VENDOR}:{USB_PRODUCT}); is it plugged in?"
                " A sensor on RS-232 needs its port and baud in the configuration"
            )
        right = [path for path in paths if path not in self._known or self._is_wanted(self._known[path])]
        if not right:
            units = ", ".join(f"{path}: {self._known[path].version.serial}" for path in paths)
            raise PortMissingError(f"no unit {self._serial()} among the sensors plugged in ({units})")
        return right[self._failures % len(right)]

    def _serial(self) -> str:
        """Return the number of the only unit that will do, "" if any will.

        A sensor at a given port that comes back at another one has to be the same sensor.
        """
        if self.config.serial or self.config.port == "auto" or self._connected is None:
            return self.config.serial
        return self._connected.identity.version.serial

    def _is_wanted(self, identity: Identity) -> bool:
        return self._serial() in ("", identity.version.serial)

    def _connect(self, path: str) -> Waiting:
        stream = self._open_stream(path, self.config.baud or connect.USB_BAUD)
        link = self._link = Link(stream, self.decoder, self._now_ns)
        baud = yield from connect.find_rate(link, self.config, insist=self._failures > 0)
        if self.config.baud not in (0, baud):
            yield from connect.change_rate(link, self.config.baud)
        if path not in self._known:
            identity = yield from connect.identify(link)
            self._known[path] = identity
            for warning in (*identity.version.warnings, *identity.parameters.warnings):
                yield Notice("warn", f"{path}: {warning}")
        identity = self._known[path]
        if not self._is_wanted(identity):
            raise SilentError(f"{path}: unit {identity.version.serial!r}, wanted {self._serial()!r}")
        if self.config.sensitive and not (yield from connect.set_sensitive(link)):
            yield Notice("warn", f"{path}: this firmware has no sensitive mode; going on without")
        request = self.config.request(identity.parameters)
        connect.check_request(request, self.config, identity.parameters)
        sweep = Sweep.of(request, identity.parameters)
        if self._connected and self._connected.sweep != sweep:
            raise ProtocolError(f"{path}: this sensor has other rays than the one before; start again")
        self._connected = Connected(
            path=path, baud=self.config.baud, identity=identity, request=request, sweep=sweep
        )
        self._forget_time()
        yield from connect.start(link, request)
        yield self._connected

    def _forget_time(self) -> None:
        self.clock.restart()
        self.sequence.restart()
        self._held.clear()

    # ---- streaming

    def _stream(self) -> Waiting:
        """Pass scans on, and see to it that they keep coming; return only by an error."""
        link, connected = self._link, self._connected
        assert link is not None
        assert connected is not None
        watch = Watch(self._now_ns(), connected.sweep.period_s)
        while True:
            damaged = self.decoder.damaged.total()
            for reply in link.listen():
                if isinstance(reply, Reply):
                    if reply.echo[:13] == connected.request.steps:
                        yield from self._status(link, reply, connected.request, watch)
                elif self.sequence.fresh(reply.stamp_ms):
                    if watch.good(reply.at_ns):
                        yield Notice("ok", f"{connected.path}: streaming")
                    self._failures = self._faults = 0
                    yield from self._stamped(reply, connected)
            now_ns = self._now_ns()
            if watch.damaged(self.decoder.damaged.total() - damaged, now_ns):
                yield Notice("warn", f"{connected.path}: many damaged scans; starting again; check the cable")
                yield from self._restart(link, connected.request, watch, RESET_S)
            if remedy := watch.due(now_ns):
                yield from self._cure(remedy, link, connected, watch)
            yield None

    def _cure(self, remedy: Remedy, link: Link, connected: Connected, watch: Watch) -> Waiting:
        ill = f"{connected.path}: no scan for {watch.quiet_s(self._now_ns()):.1f} s"
        if remedy is Remedy.REPORT:
            yield Notice("warn", ill)
        elif remedy is Remedy.RESTART:
            yield Notice("warn", f"{ill}; starting the stream again")
            yield from self._restart(link, connected.request, watch, RESET_S)
        elif remedy is Remedy.RESET:
            self.counts["resets"] += 1
            yield Notice("error", f"{ill}; resetting the sensor")
            yield from link.ask(b"RS", connect.ANSWER_S)
            if connected.baud:
                raise SilentError(f"{ill}; its rate is back at the default, opening the port again")
            self._forget_time()
            yield from self._restart(link, connected.request, watch, REOPEN_S)
        else:
            raise SilentError(f"{ill}; opening the port again")

    def _restart(self, link: Link, request: StreamRequest, watch: Watch, until_s: float) -> Waiting:
        """Stop the stream and start it again; try until the next remedy is due."""
        self.counts["restarts"] += 1
        while True:
            # A sensor that lost power meanwhile is in SCIP 1.1 again: wake knows.
            if (yield from connect.wake(link)):
                try:
                    yield from connect.start(link, request)
                    watch.restarted(self._now_ns())
                    return
                except SilentError:
                    pass  # it fell silent between two answers
            if watch.quiet_s(self._now_ns()) >= until_s:
                return

    def _status(self, link: Link, reply: Reply, request: StreamRequest, watch: Watch) -> Waiting:
        """Act on a status that came instead of a scan."""
        if b"21" <= reply.status <= b"49":
            watch.wait(self._now_ns())
            text = f"the sensor stopped to verify an error (status {reply.status.decode()})"
            yield Notice("warn", f"{link.stream.path}: {text}")
        elif b"50" <= reply.status <= b"97":
            self.counts["faults"] += 1
            self._faults += 1
            fault = connect.refusal(link.stream.path, request, reply)
            yield Notice("error", str(fault))
            yield from link.ask(b"QT", connect.ANSWER_S)
            yield from self._pause(_FAULT_WAIT_S)
            yield from link.ask(b"RS", connect.ANSWER_S)
            raise fault

    def _stamped(self, reply: ScanReply, connected: Connected) -> Iterator[UrgScan]:
        """Pass on every scan whose time is certain now."""
        self._held.append(reply)
        for step_0_ns in self.clock.observe(reply.stamp_ms, reply.at_ns):
            scan = self._held.popleft()
            if step_0_ns is None:
                continue
            ranges = to_ranges(scan.values, connected.request, connected.identity.parameters)
            self.counts["scans"] += 1
            self.counts["beyond"] += ranges.beyond
            self.counts["impossible"] += ranges.impossible
            for code in np.flatnonzero(ranges.codes):
                self.counts[f"code_{code}"] += int(ranges.codes[code])
            yield UrgScan(
                stamp_ns=step_0_ns + round(connected.sweep.first_ray_s * 1e9),
                arrival_ns=scan.at_ns,
                sensor_ms=scan.stamp_ms,
                ranges_m=ranges.metres,
                valid=connected.sweep.count - int(ranges.codes.sum()) - ranges.impossible,
            )

    # ---- failing and stopping

    def _judge(self, error: DeviceError, path: str, since_start_s: float) -> Notice:
        """Count a failure; raise it if waiting cannot help."""
        never = self._connected is None
        closed = isinstance(error, PortMissingError | PortForbiddenError | PortBusyError)
        if closed and never and since_start_s >= self._patience_s:
            raise error
        if isinstance(error, ProtocolError) and (len(self._find()) < 2 or since_start_s >= _READY_S):
            raise error
        if isinstance(error, TransportError):
            self._known.pop(path, None)  # what is plugged in next may be another unit
        self._failures += 1
        self.counts["failures"] += 1
        return Notice("warn" if never and since_start_s < _READY_S else "error", str(error))

    def _back_off_s(self) -> float:
        if self._faults >= _FAULT_TRIES:
            return _FAULT_RETRY_S
        return _BACK_OFF_S[min(max(self._failures - 1, 0), len(_BACK_OFF_S) - 1)]

    def _pause(self, duration_s: float) -> Waiting:
        """Let time pass; the line, if there is one, is read and dropped meanwhile."""
        began_ns = self._now_ns()
        while self._elapsed_s(began_ns) < duration_s:
            if self._link:
                self._link.listen()
            else:
                self._sleep(POLL_S)
            yield None

    def _elapsed_s(self, since_ns: int) -> float:
        return (self._now_ns() - since_ns) / 1e9

    def _close(self) -> None:
        """Stop the stream, wait for the answer as long as is decent, and give the port back."""
        link, self._link = self._link, None
        if link is None:
            return
        try:
            link.stream.write(b"QT" + LF)
            began_ns = self._now_ns()
            while self._elapsed_s(began_ns) < _STOP_S:
                if any(isinstance(reply, Reply) and reply.echo == b"QT" for reply in link.listen()):
                    break
        except TransportError:
            return  # unplugged: there is nothing left to stop
        finally:
            link.decoder.reset()
            link.stream.close()
