"""A whole robot of emulated devices, started for a bench in a folder of its own; nothing is measured here."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def started(graph, folder, *options):
    """Start a robot; results go to `folder`/res, sockets to `folder`/run; return its process."""
    environment = {**os.environ, "HALLWAY_RUN": f"{folder}/run", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "runtime.cli", "up", str(graph), "--out", f"{folder}/res", *options]
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, cwd=ROOT)
