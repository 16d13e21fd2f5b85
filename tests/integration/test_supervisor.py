"""Real processes under supervision: started in order, started again, and given up."""

import os
import signal
import time

import pytest

from runtime.graph import NodeSpec
from runtime.supervision.child import State
from tests.integration.supervised import POLITE, SLEEPS


def test_a_node_starts_when_those_before_it_are_ready(scene):
    stage = scene({"b": SLEEPS, "a": SLEEPS}, b=NodeSpec(module="m", after=("a",)))
    stage.until(lambda: stage.state("a") is State.STARTING)
    assert stage.state("b") is State.WAITING
    stage.ready = {"a"}
    stage.until(lambda: stage.state("b") is State.STARTING)
    assert stage.state("a") is State.RUNNING
    assert not stage.supervisor.all_ready
    stage.ready = {"a", "b"}
    stage.until(lambda: stage.supervisor.all_ready)


def test_what_runs_elsewhere_is_waited_for_once_and_neither_started_nor_missed(scene):
    after = {"b": NodeSpec(module="m", after=("a",)), "c": NodeSpec(module="m", after=("b",))}
    stage = scene(dict.fromkeys("cbad", SLEEPS), elsewhere=("a",), **after)
    assert set(stage.children) == {"b", "c", "d"}
    stage.supervisor.step(set())
    assert (stage.state("b"), stage.state("c")) == (State.WAITING, State.WAITING)
    assert not stage.supervisor.all_here
    stage.ready = {"d"}
    stage.until(lambda: stage.supervisor.all_here)  # the robot is up, and waits for another machine
    assert not stage.supervisor.all_ready
    stage.ready = {"a", "d", "teleop_1"}
    stage.until(lambda: stage.state("b") is State.STARTING)
    assert not stage.supervisor.all_here
    assert stage.supervisor._met == {"a"}  # guests come and go for weeks
    stage.ready, stage.silent = {"b", "c", "d"}, {"a"}
    stage.until(lambda: stage.supervisor.all_ready)
    assert stage.supervisor.all_here
    stage.children["b"].signal(signal.SIGKILL)
    stage.until(lambda: stage.state("b") is State.RUNNING)  # though the other is away now


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGSTOP])
def test_a_process_that_dies_or_freezes_is_there_again_within_two_seconds(scene, number):
    stage = scene({"a": SLEEPS})
    stage.ready = {"a"}
    stage.until(lambda: stage.state("a") is State.RUNNING)
    stage.ready = set()
    first = stage.children["a"].pid
    began = time.monotonic()
    os.kill(first, number)
    stage.until(lambda: stage.children["a"].pid not in (None, first))
    assert time.monotonic() - began < 2.0
    assert stage.children["a"].restarts == 1
    why = "was stopped by a signal" if number == signal.SIGSTOP else f"killed by {number.name}"
    assert stage.children["a"].reasons[-1] == why
    assert stage.forgotten == ["a"]


def test_each_failure_waits_longer_and_a_crash_loop_is_given_up(scene, monkeypatch):
    monkeypatch.setattr("runtime.supervision.child._BACKOFF_S", (0.0, 0.01, 0.02, 0.03, 0.04, 0.05))
    stage = scene({"a": "import sys; sys.exit('boom: 7 is too much')"})
    stage.until(lambda: stage.supervisor.over)
    assert stage.state("a") is State.FAILED
    assert stage.children["a"].restarts == 5
    assert stage.said("a")[1] == "exit code 1: boom: 7 is too much; starts again in 0 s"
    assert stage.said("a")[3] == "exit code 1: boom: 7 is too much; starts again in 0.01 s"
    assert stage.said("a")[-1] == "exit code 1: boom: 7 is too much; crash loop: 6 failures, given up"
    assert stage.supervisor.failed is stage.children["a"]


def test_a_wrong_configuration_or_a_missing_device_is_not_tried_again(scene):
    for code in (2, 3):
        stage = scene({"a": f"import sys; sys.exit({code})"})
        stage.until(lambda stage=stage: stage.supervisor.over)
        assert (stage.children["a"].restarts, stage.children["a"].exit_code) == (0, code)


def test_a_device_that_was_there_once_is_waited_for(scene):
    stage = scene({"a": "import sys, time; time.sleep(0.3); sys.exit(3)"})
    stage.ready = {"a"}
    stage.until(lambda: stage.children["a"].restarts == 1)
    assert stage.supervisor.failed is None


def test_the_end_of_a_required_node_ends_the_run_and_that_of_another_does_not(scene):
    never = NodeSpec(module="m", restart="never")
    optional = NodeSpec(module="m", restart="never", required=False)
    stage = scene({"a": "raise SystemExit(1)", "b": POLITE}, a=optional)
    stage.until(lambda: stage.state("a") is State.FAILED)
    assert not stage.supervisor.stopping
    stage = scene({"a": "raise SystemExit(4)", "b": POLITE}, a=never)
    stage.until(lambda: stage.supervisor.over)
    assert stage.supervisor.failed.exit_code == 4
    assert stage.state("b") is State.ENDED


def test_a_node_that_has_done_its_work_is_not_started_again_unless_it_always_is(scene):
    stage = scene({"a": "", "b": ""}, b=NodeSpec(module="m", restart="always"))
    stage.until(lambda: stage.state("a") is State.ENDED and stage.children["b"].restarts > 0)
    assert stage.children["a"].restarts == 0
    assert stage.said("a") == ["starts", "ended by itself"]


def test_a_node_that_is_never_ready_is_ended_and_says_so(scene):
    stage = scene({"a": SLEEPS}, a=NodeSpec(module="m", start_s=0.2, restart="never"))
    stage.until(lambda: stage.state("a") is State.FAILED)
    assert stage.children["a"].reasons[-1] == "was not ready within 0.2 s"


def test_a_node_that_does_not_speak_is_started_again_but_not_in_its_first_seconds(scene, monkeypatch):
    monkeypatch.setattr("runtime.supervision.supervisor.SILENT_S", 0.3)
    stage = scene({"a": SLEEPS})
    stage.ready, stage.silent = {"a"}, {"a"}
    stage.until(lambda: stage.state("a") is State.RUNNING)
    began = time.monotonic()
    stage.until(lambda: stage.children["a"].restarts == 1)
    assert time.monotonic() - began > 0.25
    assert stage.children["a"].reasons[-1] == "does not speak any more"


def test_a_node_whose_loop_hangs_while_it_speaks_is_started_again_and_one_that_works_long_is_not(
    scene, monkeypatch
):
    monkeypatch.setattr("runtime.supervision.supervisor.SILENT_S", 0.3)
    stage = scene({"hangs": SLEEPS, "works": SLEEPS}, hangs=NodeSpec(module="m", turn_s=10.0))
    stage.ready = {"hangs", "works"}
    stage.loop_ages_s = {"hangs": 10.5, "works": 10.5}
    stage.until(lambda: stage.supervisor.all_ready)
    began = time.monotonic()
    stage.until(lambda: stage.children["hangs"].restarts == 1)
    assert time.monotonic() - began > 0.25  # what it said may be of the time before it was ready
    assert list(stage.children["hangs"].reasons) == ["its loop has not turned for 10 s"]
    assert stage.children["works"].restarts == 0


def test_one_that_was_ended_and_does_not_go_is_ended_once(scene, monkeypatch):
    monkeypatch.setattr("runtime.supervision.supervisor.SILENT_S", 0.1)
    stage = scene({"mute": SLEEPS, "late": SLEEPS}, late=NodeSpec(module="m", start_s=0.1))
    for child in stage.children.values():  # as if the disk held it
        monkeypatch.setattr(child, "signal", lambda number: None)
    stage.ready = stage.silent = {"mute"}
    stage.until(lambda: all(child.dying for child in stage.children.values()))
    for _ in range(3):
        stage.supervisor.step(stage.ready, stage.silent)
    assert stage.said("mute") == ["starts", "ready", "does not speak any more"]
    assert stage.said("late") == ["starts", "was not ready within 0.1 s"]
    monkeypatch.undo()


def test_a_supervisor_that_was_stopped_itself_takes_nobody_for_silent(scene, monkeypatch):
    monkeypatch.setattr("runtime.supervision.supervisor.SILENT_S", 0.3)
    monkeypatch.setattr("runtime.supervision.supervisor._STALL_S", 0.1)
    stage = scene({"a": SLEEPS})
    stage.ready = {"a"}
    stage.until(lambda: stage.state("a") is State.RUNNING and stage.children["a"].age_s > 0.35)
    time.sleep(0.15)  # as after Ctrl-Z: what was said meanwhile was not heard
    stage.silent, stage.loop_ages_s = {"a"}, {"a": 100.0}
    began = time.monotonic()
    stage.until(lambda: time.monotonic() - began > 0.25)
    assert stage.children["a"].restarts == 0
    stage.until(lambda: stage.children["a"].restarts == 1)  # it is given its time, and no more
