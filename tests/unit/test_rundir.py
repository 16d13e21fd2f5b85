"""Whether a robot of this machine is there, or was."""

import pytest

from runtime import rundir
from runtime.errors import ConfigError


@pytest.fixture
def now(monkeypatch, tmp_path):
    monkeypatch.setenv("HALLWAY_RUN", str(tmp_path))
    time = [100.0]
    monkeypatch.setattr("runtime.rundir.time.monotonic", lambda: time[0])
    return time


def test_a_hub_that_begins_anew_does_not_make_its_robot_gone(now, tmp_path):
    socket = tmp_path / "robot" / "hub.sock"
    socket.parent.mkdir()
    socket.touch()
    presence = rundir.Presence("robot")
    assert not presence.gone
    for step_s, there, gone in ((50, True, False), (1, False, False), (1, True, False), (1.5, False, False)):
        now[0] += step_s
        socket.touch() if there else socket.unlink(missing_ok=True)
        assert presence.gone is gone
    now[0] += 1
    assert presence.gone


def test_a_robot_that_does_not_run_comes_with_the_next_step(now, tmp_path):
    with pytest.raises(rundir.NotRunningError, match=r"hallway up demo.*hallway keys pair"):
        rundir.running("robot")
    (tmp_path / "rover").mkdir()
    (tmp_path / "rover" / "hub.sock").touch()
    with pytest.raises(rundir.NotRunningError, match="running: rover; say which with --robot"):
        rundir.running("robot")
    assert rundir.running("rover") == tmp_path / "rover"


def test_a_robot_that_was_never_here_is_never_gone(now):
    presence = rundir.Presence("robot")
    now[0] += 1000
    assert not presence.gone


@pytest.fixture
def system(monkeypatch, tmp_path):
    """A person's place without a robot, and `/run` with one that was started at boot."""
    monkeypatch.delenv("HALLWAY_RUN", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "person"))
    monkeypatch.setattr("runtime.rundir._SYSTEM", tmp_path / "run")
    place = rundir.boot_dir("carrier") / "carrier"
    place.mkdir(parents=True)
    (place / "hub.sock").touch()
    return place


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
