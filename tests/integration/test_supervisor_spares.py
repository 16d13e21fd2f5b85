"""Processes that stand by for those that die: nobody waits for imports after a blow."""

import os
import signal

import pytest

from runtime.graph import NodeSpec
from runtime.process import realtime
from runtime.supervision.child import State
from tests.integration.supervised import alive

SPARE = """
import sys, time
if "--spare" in sys.argv:
    print("stands by", flush=True)
    if not sys.stdin.readline():
        sys.exit()
print("works", flush=True)
time.sleep(600)
"""


def test_a_spare_process_takes_over_and_another_stands_by_for_it(scene, monkeypatch):
    monkeypatch.setattr("runtime.supervision.child._SPARE_AFTER_S", 0.0)
    stage = scene({"a": SPARE}, a=NodeSpec(module="m", spare=True))
    # Nobody is ready before the line is in the log: a spare that starts beside it could write first.
    stage.until(lambda: stage.wrote("a", "works\n"))
    stage.ready = {"a"}
    stage.until(lambda: stage.wrote("a", "works\nstands by\n"))
    spare = stage.children["a"]._spare.pid
    stage.ready = set()
    os.kill(stage.children["a"].pid, signal.SIGKILL)
    stage.until(lambda: stage.wrote("a", "works\nstands by\nworks\n"))
    stage.ready = {"a"}
    stage.until(lambda: stage.wrote("a", "works\nstands by\nworks\nstands by\n"))
    assert stage.children["a"].pid == spare
    last = stage.children["a"]._spare.pid
    stage.supervisor.stop()
    stage.until(lambda: stage.supervisor.over)
    assert not alive(last)


def test_after_a_blow_the_next_one_starts_in_the_same_turn_and_another_stands_by_at_once(scene):
    stage = scene({"a": SPARE}, a=NodeSpec(module="m", spare=True))
    child = stage.children["a"]
    stage.until(lambda: stage.wrote("a", "works\n"))
    stage.ready = {"a"}
    stage.until(lambda: stage.state("a") is State.RUNNING)
    assert child._spare.pid is None  # when a run begins all others start, too
    stage.ready = set()
    os.kill(child.pid, signal.SIGKILL)
    child._process.wait()
    stage.supervisor.step(set())
    assert stage.state("a") is State.STARTING
    assert stage.said("a")[-2:] == ["killed by SIGKILL; starts again in 0 s", "starts again"]
    stage.supervisor.step({"a"})
    stage.supervisor.step({"a"})
    assert child._spare.pid is not None


def test_a_spare_process_that_is_dead_or_frozen_is_replaced_by_a_fresh_one(scene, monkeypatch):
    monkeypatch.setattr("runtime.supervision.child._SPARE_AFTER_S", 0.0)
    for number in (signal.SIGKILL, signal.SIGSTOP):
        stage = scene({"a": SPARE}, a=NodeSpec(module="m", spare=True))
        stage.ready = {"a"}
        stage.until(lambda stage=stage: stage.children["a"]._spare.pid)
        spare, first = stage.children["a"]._spare.pid, stage.children["a"].pid
        os.kill(spare, number)
        os.kill(first, signal.SIGKILL)
        stage.until(
            lambda stage=stage: stage.children["a"].restarts == 1 and stage.state("a") is State.RUNNING
        )
        assert stage.children["a"].pid not in (first, spare)
        assert not alive(spare)


IMPORTS = """
import os, sys, time
if "--spare" in sys.argv:
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    print("imports", flush=True)
    time.sleep(600)
time.sleep(600)
"""


def test_a_spare_process_that_is_called_while_it_imports_does_not_stand_aside_any_longer(scene, monkeypatch):
    monkeypatch.setattr("runtime.supervision.child._SPARE_AFTER_S", 0.0)
    if not realtime.step_aside():
        pytest.skip("who steps aside here could not step forward again")
    realtime.step_forward(0, like=os.getppid())
    stage = scene({"a": IMPORTS}, a=NodeSpec(module="m", spare=True))
    stage.ready = {"a"}
    stage.until(lambda: stage.wrote("a", "imports\n"))
    stage.ready = set()
    spare = stage.children["a"]._spare.pid
    assert os.sched_getscheduler(spare) == os.SCHED_IDLE
    os.kill(stage.children["a"].pid, signal.SIGKILL)
    stage.until(lambda: stage.children["a"].pid == spare)
    assert os.sched_getscheduler(spare) == os.sched_getscheduler(0)


def test_a_spare_that_may_not_rise_again_gives_way_to_a_process_from_the_beginning(scene, monkeypatch):
    def refuse(pid, like):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("runtime.supervision.child._SPARE_AFTER_S", 0.0)
    monkeypatch.setattr("runtime.supervision.spare.realtime.step_forward", refuse)
    stage = scene({"a": SPARE}, a=NodeSpec(module="m", spare=True))
    stage.ready = {"a"}
    stage.until(lambda: stage.children["a"]._spare.pid)
    stage.ready = set()
    spare = stage.children["a"]._spare.pid
    os.kill(stage.children["a"].pid, signal.SIGKILL)
    stage.until(lambda: stage.children["a"].restarts == 1 and stage.state("a") is State.STARTING)
    assert stage.children["a"].pid != spare
    stage.until(lambda: not alive(spare))
