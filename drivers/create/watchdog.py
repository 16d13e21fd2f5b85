"""A process that stops the robot when its driver cannot: hung, killed, or gone with its supervisor.

Started by `guard.Guard` as a script of its own, with nothing but the standard library, in its own session,
so that neither a signal to the driver's group nor an import that fails can take it along.  It holds a copy of
the line's descriptor, and says nothing on it as long as the driver beats.

A driver that is silent for much longer is killed: as long as it hangs it holds the port, and nobody else can
drive the robot either.

The link is a socket: `L` with a descriptor hands over a line, `R` takes it back, `M` and `S` are beats of a
driver that may move the robot and of one that does not.  Every beat is answered with one byte.  End of file
means that the driver is dead.
"""

import contextlib
import os
import select
import signal
import socket
import sys
import termios
import time

STOP = bytes(40) + b"\x91\x00\x00\x00\x00" + b"\x80"
"""`protocol.RESYNCHRONISE`: ends a cut command, wheels to zero, Passive mode; good in any state."""
_TURN_S = 0.02
_AGAIN_S = 0.1
_LAST_WORDS = 3


def watch(link: socket.socket, driver: int, silence_s: float, deaf_s: float) -> None:
    """Watch the driver, a process, until it is gone; then stop the robot that it left."""
    line = -1
    moving = False
    heard = stopped = time.monotonic()
    _answer(link)  # awake
    try:
        while True:
            select.select([link], [], [], _TURN_S)
            while (mail := _mail(link)) is not None:
                message, fds = mail
                heard = time.monotonic()
                if not message:
                    return
                if message in (b"L", b"R"):
                    if line >= 0:
                        os.close(line)
                    line = fds[0] if fds else -1
                else:
                    _answer(link)
                moving = message == b"M"
            now = time.monotonic()
            if moving and line >= 0 and now - heard > silence_s and now - stopped > _AGAIN_S:
                stopped = now
                stop(line)
            if now - heard > deaf_s and os.getppid() == driver:
                stop(line)
                os.kill(driver, signal.SIGKILL)
    finally:
        _bury(line)


def _mail(link: socket.socket) -> tuple[bytes, list[int]] | None:
    """Return the next message and its descriptors, b"" when the driver is gone; None if there is none yet."""
    while True:
        try:
            message, fds, _, _ = socket.recv_fds(link, 16, 4)
        except BlockingIOError:
            return None
        except ConnectionResetError:
            continue  # told once, of a driver that left answers unread; what it said is still to be read
        return message, fds


def _answer(link: socket.socket) -> None:
    with contextlib.suppress(OSError):  # a driver that does not listen has still said what it said
        link.send(b".")


def stop(line: int) -> bool:
    """Tell the robot to stand; return whether the line took it."""
    try:
        if os.write(line, STOP) == len(STOP):
            return True
    except BlockingIOError:
        pass
    except OSError:
        return False  # unplugged
    # Full of what a hung driver had to say: none of that matters any more.
    with contextlib.suppress(OSError, termios.error):
        termios.tcflush(line, termios.TCOFLUSH)
        return os.write(line, STOP) == len(STOP)
    return False


def _bury(line: int) -> None:
    """Stop the robot of a dead driver, more than once, because a byte may get lost."""
    if line < 0:
        return
    for _ in range(_LAST_WORDS):
        stop(line)
        time.sleep(_TURN_S)
    os.close(line)


def main() -> None:
    """Run with the link's descriptor, the driver's pid, and its silence in ms until a stop, until a kill."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(OSError):  # only where the user may
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5))
    descriptor, driver, silence_ms, deaf_ms = map(int, sys.argv[1:])
    with socket.socket(fileno=descriptor) as link:
        link.setblocking(False)
        watch(link, driver, silence_ms / 1000, deaf_ms / 1000)


if __name__ == "__main__":
    main()
