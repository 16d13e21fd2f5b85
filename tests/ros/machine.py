"""The interpreter of an environment with ROS 2: `.venv-ros`, or where HALLWAY_ROS_PYTHON says."""

import json
import os
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


def ros_python():
    """Return the interpreter; without one skip by name, or fail where CI_REQUIRE_ROS asks for one."""
    named = os.environ.get("HALLWAY_ROS_PYTHON")
    found = Path(named) if named else ROOT / ".venv-ros" / "bin" / "python"
    if not found.exists():
        text = f"needs ROS 2 type support: {found} (tests/ros/requirements.txt)"
        (pytest.fail if os.environ.get("CI_REQUIRE_ROS") else pytest.skip)(text)
    return found


def ros_environment(**more):
    """Return an environment in which nothing of ours is found."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith("HALLWAY")}
    theirs = [path for path in kept.pop("PYTHONPATH", "").split(os.pathsep) if path and Path(path) != ROOT]
    return {**kept, "PYTHONPATH": os.pathsep.join(theirs), **more}


def ask(script, question, within_s=60.0):
    """Run one of the scripts beside this file; its question and answer are JSON."""
    done = subprocess.run(
        [ros_python(), HERE / script],
        input=json.dumps(question),
        env=ros_environment(GIT_PYTHON_REFRESH="quiet"),  # the client can fetch definitions; here it need not
        capture_output=True,
        text=True,
        timeout=within_s,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
