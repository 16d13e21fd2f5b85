"""What a process asks of the kernel: to die with its parent, to be scheduled first, to stay on its cores.

Everything here is a wish: where the kernel says no, the process warns once and goes on.
"""

import contextlib
import ctypes
import gc
import logging
import os
import resource
import signal
import sys
from collections.abc import Sequence

_PR_SET_PDEATHSIG = 1
_RLIMIT_OF_NICE_0 = 20
_NOTIFY_VARIABLE = "NOTIFY_SOCKET"
PARENT_VARIABLE = "HALLWAY_PARENT_PID"
"""In the environment of a process: who started it."""
_SWITCH_S = 0.001
"""How long one thread may hold the interpreter while another waits; a message should not wait for 5 ms."""

THREAD_LIMITS = {
    "NUMBA_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
}
"""Environment of every process: a robot's cores are shared by processes, not by hidden thread pools."""


MEMORY_LIMITS = {"MALLOC_MMAP_THRESHOLD_": str(1 << 20), "MALLOC_TRIM_THRESHOLD_": str(1 << 23)}
"""Environment, too: what is large goes back to the system when it is let go of. Left alone, glibc learns from
the first large arrays to keep the next ones in its heap, where what is small and stays behind them holds the
room: a mapper had 25 MB of nothing after an hour, in steps."""


def die_with_parent(parent_pid: int | None = None) -> None:
    """Get SIGTERM when the parent goes, however it goes; leave at once if it has gone already."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if parent_pid is not None and os.getppid() != parent_pid:
        sys.exit(1)


def follow_parent() -> None:
    """Die with the process that started this one, if it left its name in the environment."""
    parent = os.environ.get(PARENT_VARIABLE)
    if parent:
        die_with_parent(int(parent))


def schedule(log: logging.Logger, *, priority: int = 0, nice: int = 0, cores: Sequence[int] = ()) -> None:
    """Set this process's scheduling; threads made later inherit it, so call it before the bus is opened.

    Args:
        log: Gets one warning if the kernel refuses something.
        priority: Of SCHED_FIFO, 1 .. 99; 0 for the ordinary scheduler.
        nice: Added niceness for the ordinary scheduler.
        cores: CPU numbers to stay on; all if empty.
    """
    sys.setswitchinterval(_SWITCH_S)
    refused: list[str] = []
    if priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except OSError as error:
            refused.append(f"SCHED_FIFO {priority} ({error.strerror})")
    elif nice:
        try:
            os.nice(nice)
        except OSError as error:
            refused.append(f"nice {nice} ({error.strerror})")
    if cores:
        try:
            os.sched_setaffinity(0, set(cores))
        except (OSError, ValueError) as error:
            refused.append(f"cores {list(cores)} ({error})")
    if refused:
        log.warning("the kernel refuses %s; running without", ", ".join(refused))


def step_aside() -> bool:
    """Run only when nobody else wants to, if it can be taken back; return whether."""
    # Without this right the kernel lets a process lower itself and never rise again.
    if os.geteuid() != 0 and resource.getrlimit(resource.RLIMIT_NICE)[0] < _RLIMIT_OF_NICE_0:
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    except OSError:
        return False
    return True


def step_forward(pid: int, like: int) -> None:
    """Let a process that has stepped aside be scheduled like another one again; 0 is this process."""
    if os.sched_getscheduler(pid) == os.SCHED_IDLE:
        os.sched_setscheduler(pid, os.sched_getscheduler(like), os.sched_getparam(like))


def settle() -> None:
    """Take what the start allocated out of the collector's sight; call after warm-up."""
    gc.collect()
    gc.freeze()


def is_watched() -> bool:
    """Whether systemd started this process and waits for what it says."""
    return bool(os.environ.get(_NOTIFY_VARIABLE))


def notify_init(text: str) -> bool:
    """Tell systemd `READY=1`, `WATCHDOG=1` or `STATUS=...`; False where nobody listens."""
    import socket

    address = os.environ.get(_NOTIFY_VARIABLE)
    if not address:
        return False
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line, contextlib.suppress(OSError):
        line.connect("\0" + address[1:] if address.startswith("@") else address)
        line.sendall(text.encode())
        return True
    return False
