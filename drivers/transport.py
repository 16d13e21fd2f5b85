"""A serial line as bytes in and bytes out; the only place that knows pyserial.

Law: whatever the operating system throws when a cable is pulled leaves here as one TransportError.
"""

import errno
import os
import select
import termios
from types import TracebackType

import serial

from drivers.errors import PortBusyError, PortForbiddenError, PortMissingError, TransportError
from drivers.ports import holders

# pyserial and the kernel raise all of these for one and the same pulled cable: SerialException is an OSError,
# others are a bare OSError 5, a closed descriptor is None and so a TypeError, termios has a tree of its own.
_LINE_FAILURES = (OSError, TypeError, ValueError, termios.error)
_READ_BYTES = 4096
_WRITE_TIMEOUT_S = 1.0


class SerialStream:
    """A serial port held alone: 8 data bits, no parity, 1 stop bit, no flow control, nothing translated.

    One thread owns it. Neither RTS nor DTR is ever touched: some boards reset on them, and a pseudo-terminal
    refuses them.

    Args:
        path: The port's node, e.g. /dev/ttyACM0.
        baud: Bits per second; without meaning for a device that is itself on USB.
        timeout_s: How long `read` waits for a first byte.
        write_timeout_s: How long `write` waits for a line that takes no bytes; one second if None.

    Raises:
        PortMissingError: There is no such node.
        PortForbiddenError: This user may not open it.
        PortBusyError: Another process holds it.
        TransportError: It cannot be opened for another reason.
    """

    def __init__(
        self, path: str, baud: int, timeout_s: float = 0.05, write_timeout_s: float | None = None
    ) -> None:
        self.path = path
        self._write_timeout_s = _WRITE_TIMEOUT_S if write_timeout_s is None else write_timeout_s
        self._timeout_ms = max(0, round(timeout_s * 1000))
        self._serial = _open(path, baud, self._write_timeout_s)
        self._poll = select.poll()
        self._poll.register(self._serial.fileno(), select.POLLIN)

    @property
    def baud(self) -> int:
        """The rate in use."""
        return int(self._serial.baudrate)

    def fileno(self) -> int:
        """The line's descriptor, for a process that must be able to speak when this one cannot."""
        return int(self._serial.fileno())

    def set_baud(self, baud: int) -> None:
        """Change the rate of this side of the line.

        Raises:
            TransportError: The line is gone, or cannot run at this rate.
        """
        try:
            self._serial.baudrate = baud
        except _LINE_FAILURES as error:
            raise TransportError(f"{self.path}: cannot run at {baud} baud ({error})") from error

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return what has arrived, at once; wait at most the time-out for a first byte, then return b"".

        Args:
            timeout_s: Instead of the stream's own time-out.

        Raises:
            TransportError: The line stopped.
        """
        wait_ms = self._timeout_ms if timeout_s is None else max(0, round(timeout_s * 1000))
        if not self._serial.is_open:
            raise TransportError(f"{self.path}: stopped, the port is closed")
        try:
            # Not pyserial's read, which waits for a number of bytes: a message has to be seen when it begins.
            if not self._poll.poll(wait_ms):
                return b""
            chunk = os.read(self._serial.fileno(), _READ_BYTES)
        except BlockingIOError:
            return b""
        except _LINE_FAILURES as error:
            raise TransportError(f"{self.path}: stopped, unplugged or powered off ({error})") from error
        if not chunk:
            raise TransportError(f"{self.path}: stopped, unplugged or powered off (end of file)")
        return chunk

    def write(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            TransportError: The line stopped, or takes no bytes for as long as `write` waits.
        """
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException as error:
            raise TransportError(
                f"{self.path}: stopped, takes no bytes for {self._write_timeout_s:g} s"
            ) from error
        except _LINE_FAILURES as error:
            raise TransportError(f"{self.path}: stopped, unplugged or powered off ({error})") from error

    def close(self) -> None:
        """Give the port back; closing twice, or after the cable was pulled, is fine."""
        try:
            self._serial.close()
        except _LINE_FAILURES:
            return  # the node is gone, and with it everything that closing would give back

    def __enter__(self) -> "SerialStream":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _open(path: str, baud: int, write_timeout_s: float) -> serial.Serial:
    try:
        return serial.Serial(
            path,
            baud,
            bytesize=serial.EIGHTBITS,
            parity=serial.PARITY_NONE,
            stopbits=serial.STOPBITS_ONE,
            timeout=0,
            write_timeout=write_timeout_s,
            xonxoff=False,
            rtscts=False,
            dsrdtr=False,
            exclusive=True,
        )
    except _LINE_FAILURES as error:
        raise _why(path, error) from error


def _why(path: str, error: BaseException) -> TransportError:
    code = getattr(error, "errno", None)
    if code in (errno.ENOENT, errno.ENXIO, errno.ENODEV):
        return PortMissingError(f"{path}: no such port; is the cable plugged in, is the device powered?")
    if code in (errno.EACCES, errno.EPERM):
        return PortForbiddenError(
            f"{path}: permission denied; join the group that owns it, then log in again"
        )
    if code in (errno.EAGAIN, errno.EBUSY):
        names = ", ".join(map(str, holders(path))) or "another process"
        return PortBusyError(f"{path}: held by {names}; end it first")
    return TransportError(f"{path}: cannot be opened ({error})")
