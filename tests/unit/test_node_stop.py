"""A node is asked to stop by signals, which come at any moment and more than once."""

import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

from runtime.bus.memory import MemoryBus
from runtime.process.node import BusPort

ROOT = Path(__file__).resolve().parents[2]


def test_asking_a_node_to_stop_takes_no_lock():
    port = BusPort("node", MemoryBus().join)
    # A signal that arrives while the interpreter sets or waits for the event finds its lock taken.
    with port._closing._cond:
        port.stop()
    assert port.stopping
    port.close()


def test_a_hail_of_signals_ends_a_node():
    program = """
        import signal
        from runtime.bus.memory import MemoryBus
        from runtime.process.node import BusPort
        port = BusPort("node", MemoryBus().join)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: port.stop())
        print("up", flush=True)
        with port:
            port.ready()
            while not port.stopping:
                pass
            for number in (signal.SIGTERM, signal.SIGINT):
                signal.signal(number, signal.SIG_IGN)
    """
    command = [sys.executable, "-c", textwrap.dedent(program)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"up\n"
        for _ in range(200):
            if process.poll() is None:
                os.kill(process.pid, signal.SIGTERM)
                os.kill(process.pid, signal.SIGINT)
        assert process.wait(10) == 0
