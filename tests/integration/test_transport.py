"""The serial stream on a real pseudo-terminal: what comes in, what goes out, and every way it can end."""

import os
import pty
import subprocess
import sys
import termios
import tty

import pytest

from drivers.errors import PortBusyError, PortForbiddenError, PortMissingError, TransportError
from drivers.transport import SerialStream


class Line:
    """Both ends of a pseudo-terminal; the far end belongs to the test."""

    def __init__(self):
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)

    def pull(self):
        """Do to the line what pulling the cable does."""
        for fd in (self.master, self.slave):
            os.close(fd)
        self.master = self.slave = -1

    def close(self):
        if self.master >= 0:
            self.pull()


@pytest.fixture
def line():
    line = Line()
    yield line
    line.close()


def test_every_byte_passes_unchanged_both_ways(line):
    everything = bytes(range(256)) * 2
    with SerialStream(line.path, 115_200) as stream:
        os.write(line.master, everything)
        got = b""
        while len(got) < len(everything):
            got += stream.read(1.0)
        assert got == everything
        stream.write(everything)
        sent = b""
        while len(sent) < len(everything):
            sent += os.read(line.master, 4096)
        assert sent == everything


def test_the_line_is_opened_with_eight_bits_no_parity_one_stop_bit_and_no_flow_control(line):
    with SerialStream(line.path, 57_600):
        iflag, oflag, cflag, lflag, ispeed, ospeed, _ = termios.tcgetattr(line.master)
    assert cflag & termios.CSIZE == termios.CS8
    assert not cflag & (termios.PARENB | termios.CSTOPB | termios.CRTSCTS)
    assert not iflag & (termios.IXON | termios.IXOFF | termios.ICRNL | termios.INLCR | termios.ISTRIP)
    assert not oflag & termios.OPOST
    assert not lflag & (termios.ECHO | termios.ICANON | termios.ISIG)
    assert ispeed == ospeed == termios.B57600


def test_a_change_of_rate_reaches_the_line(line):
    with SerialStream(line.path, 19_200) as stream:
        stream.set_baud(500_000)
        assert termios.tcgetattr(line.master)[4] == termios.B500000
        assert stream.baud == 500_000


def test_silence_is_an_empty_answer_and_no_error(line):
    with SerialStream(line.path, 115_200, timeout_s=0.0) as stream:
        assert stream.read() == b""
        assert stream.read(0.01) == b""


def test_a_second_opening_is_refused(line):
    with (
        SerialStream(line.path, 115_200),
        pytest.raises(PortBusyError, match=f"{line.path}: held by"),
    ):
        SerialStream(line.path, 115_200)


def test_the_process_that_holds_the_port_is_named(line):
    hold = (
        "import sys; from drivers.transport import *; s = SerialStream(sys.argv[1], 9600); print(); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", hold, line.path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        other.stdout.readline()
        with pytest.raises(PortBusyError, match=f"process {other.pid}"):
            SerialStream(line.path, 115_200)
        other.communicate(b"\n")


def test_a_missing_port_says_so():
    with pytest.raises(PortMissingError, match="/dev/ttyNOWHERE: no such port"):
        SerialStream("/dev/ttyNOWHERE", 115_200)


def test_a_forbidden_port_says_what_to_do(monkeypatch):
    def forbidden(*_arguments, **_options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("drivers.transport.serial.Serial", forbidden)
    with pytest.raises(PortForbiddenError, match="group"):
        SerialStream("/dev/ttyACM0", 115_200)


def test_a_pulled_cable_is_one_error_for_reading_writing_and_the_rate(line):
    with SerialStream(line.path, 115_200) as stream:
        line.pull()
        for act in (stream.read, lambda: stream.write(b"QT\n"), lambda: stream.set_baud(19_200)):
            with pytest.raises(TransportError, match=line.path):
                act()


def test_a_closed_stream_reports_itself_stopped_and_closes_twice(line):
    stream = SerialStream(line.path, 115_200)
    stream.close()
    stream.close()
    for act in (stream.read, lambda: stream.write(b"QT\n")):
        with pytest.raises(TransportError, match="stopped"):
            act()


def test_a_line_that_takes_no_bytes_is_an_error_and_not_a_hang(line, monkeypatch):
    monkeypatch.setattr("drivers.transport._WRITE_TIMEOUT_S", 0.05)
    with SerialStream(line.path, 115_200) as stream, pytest.raises(TransportError, match="takes no bytes"):
        stream.write(bytes(1 << 20))
