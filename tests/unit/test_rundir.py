"""Whether a robot of this machine is there, or was."""

import socket
import tempfile
from pathlib import Path

import pytest

from runtime import rundir
from runtime.errors import ConfigError


class Hub:
    """What listens where a hub does."""

    def __init__(self, place):
        place.mkdir(parents=True, exist_ok=True)
        (place / "hub.sock").unlink(missing_ok=True)
        self._line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._line.bind(str(place / "hub.sock"))
        self._line.listen()

    def die(self):
        """End as by SIGKILL: the file of the socket stays."""
        self._line.close()


@pytest.fixture
def hub():
    """Starts hubs, and ends them."""
    started = []

    def start(place):
        started.append(Hub(place))
        return started[-1]

    yield start
    for one in started:
        one.die()


@pytest.fixture
def now(monkeypatch, tmp_path):
    monkeypatch.setenv("HALLWAY_RUN", str(tmp_path))
    time = [100.0]
    monkeypatch.setattr("runtime.rundir.time.monotonic", lambda: time[0])
    return time


def test_a_hub_that_begins_anew_does_not_make_its_robot_gone(now, hub, tmp_path):
    running = hub(tmp_path / "robot")
    presence = rundir.Presence("robot")
    assert not presence.gone
    for step_s, there, gone in ((50, True, False), (1, False, False), (1, True, False), (1.5, False, False)):
        now[0] += step_s
        running.die()
        if there:
            running = hub(tmp_path / "robot")
        assert presence.gone is gone
    now[0] += 1
    assert presence.gone


def test_what_a_killed_machine_left_behind_is_no_robot_that_runs(now, hub, tmp_path):
    hub(tmp_path / "robot").die()
    hub(tmp_path / "rover").die()
    assert (tmp_path / "robot" / "hub.sock").exists()
    assert not rundir.is_running("robot")
    with pytest.raises(rundir.NotRunningError, match="'robot' does not run here, nor does any other"):
        rundir.running("robot")


def test_a_run_that_breaks_off_leaves_nothing_behind(now, tmp_path):
    def break_off():
        with rundir.claimed("robot") as path:
            (path / "hub.sock").touch()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        break_off()
    assert not (tmp_path / "robot").exists()


def test_a_robot_that_does_not_run_comes_with_the_next_step(now, hub, tmp_path):
    with pytest.raises(rundir.NotRunningError, match=r"hallway up demo.*hallway keys pair"):
        rundir.running("robot")
    hub(tmp_path / "rover")
    with pytest.raises(rundir.NotRunningError, match="running: rover; say which with --robot"):
        rundir.running("robot")
    assert rundir.running("rover") == tmp_path / "rover"


def test_a_robot_that_was_never_here_is_never_gone(now):
    presence = rundir.Presence("robot")
    now[0] += 1000
    assert not presence.gone


@pytest.fixture
def system(monkeypatch, hub):
    """A person's place without a robot, and `/run` with one that was started at boot."""
    with tempfile.TemporaryDirectory(prefix="run-") as folder:  # a socket's path is short
        monkeypatch.delenv("HALLWAY_RUN", raising=False)
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(Path(folder) / "person"))
        monkeypatch.setattr("runtime.rundir._SYSTEM", Path(folder) / "run")
        place = rundir.boot_dir("carrier") / "carrier"
        hub(place)
        yield place


def test_a_robot_that_was_started_at_boot_is_found_by_whoever_names_no_place(system, monkeypatch, tmp_path):
    assert rundir.is_running("carrier")
    assert rundir.running("carrier") == rundir.run_dir("carrier") == system
    assert not rundir.is_running("robot")
    with pytest.raises(rundir.NotRunningError, match="running: carrier"):
        rundir.running("robot")
    monkeypatch.setenv("HALLWAY_RUN", str(tmp_path / "elsewhere"))
    assert not rundir.is_running("carrier")
    with pytest.raises(rundir.NotRunningError, match="nor does any other"):
        rundir.running("carrier")


def test_a_robot_that_runs_since_boot_is_not_started_beside_itself(system):
    with pytest.raises(ConfigError, match="'carrier' runs already, since boot"), rundir.claimed("carrier"):
        pass
    with rundir.claimed("robot") as path:
        assert path == rundir.base_dir() / "robot"


def test_the_boot_robot_of_somebody_else_is_named_with_its_owner(system, monkeypatch):
    (system / "hub.sock").unlink()  # what is in the place of another cannot be seen
    monkeypatch.setattr("runtime.rundir.os.access", lambda path, mode: path != system.parent)
    with pytest.raises(rundir.NotRunningError, match="belongs to user"):
        rundir.running("carrier")
