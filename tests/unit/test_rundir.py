"""Whether a robot of this machine is there, or was."""

import pytest

from runtime import rundir


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
