"""The end of a run: everybody is asked, in order, nobody stays, and nothing starts any more."""

import os
import signal
import time

from runtime.graph import NodeSpec
from runtime.supervision.child import State
from tests.integration.supervised import POLITE, SLEEPS, STUBBORN, alive


def test_stopping_ends_the_polite_at_once_and_the_stubborn_within_two_seconds(scene):
    stage = scene({"polite": POLITE, "stubborn": STUBBORN})
    stage.until(lambda: stage.wrote("polite", "up\n") and stage.wrote("stubborn", "up\n"))
    pids = [child.pid for child in stage.children.values()]
    began = time.monotonic()
    stage.supervisor.stop()
    stage.until(lambda: stage.state("polite") is State.ENDED)
    assert time.monotonic() - began < 1.8
    stage.until(lambda: stage.supervisor.over)
    assert time.monotonic() - began < 3.0
    assert not any(alive(pid) for pid in pids)
    assert stage.said("polite")[-1] == "ended"
    assert stage.said("stubborn")[-1] == "did not end within 1.8 s"


def test_who_depends_on_others_is_asked_to_end_before_them(scene):
    stage = scene({"source": POLITE, "sink": POLITE}, source=NodeSpec(module="m", after=("sink",)))
    stage.ready = {"sink", "source"}
    stage.until(lambda: stage.supervisor.all_ready and stage.wrote("source", "up\n"))
    stage.supervisor.stop()
    stage.until(lambda: stage.supervisor.over)
    ended = [node for node, text in stage.events if text == "ended"]
    assert ended == ["source", "sink"]


def test_a_node_that_is_asked_to_end_before_it_works_just_ends(scene):
    text = "import signal; signal.signal(signal.SIGINT, signal.SIG_DFL); print('up', flush=True); "
    stage = scene({"a": text + SLEEPS})
    stage.until(lambda: stage.wrote("a", "up\n"))
    stage.supervisor.stop()
    stage.until(lambda: stage.supervisor.over)
    assert stage.said("a") == ["starts", "ended"]
    assert not stage.children["a"].reasons


def test_a_node_that_has_much_to_save_has_the_time_it_was_given(scene):
    slow = (
        "import signal, sys, time\nsignal.signal(signal.SIGINT, lambda *_: (time.sleep(2.2), sys.exit(0)))\n"
    )
    slow += "signal.signal(signal.SIGTERM, signal.SIG_IGN)\nprint('up', flush=True)\ntime.sleep(600)"
    stage = scene({"a": slow}, a=NodeSpec(module="m", stop_s=20.0))
    stage.until(lambda: stage.wrote("a", "up\n"))
    stage.supervisor.stop()
    stage.until(lambda: stage.supervisor.over)
    assert stage.said("a")[-1] == "ended"


def test_a_stopped_process_is_ended_like_any_other(scene):
    stage = scene({"a": POLITE})
    stage.until(lambda: stage.wrote("a", "up\n"))
    os.kill(stage.children["a"].pid, signal.SIGSTOP)
    stage.supervisor.stop()
    stage.until(lambda: stage.supervisor.over)
    assert stage.state("a") is State.ENDED


def test_what_a_dead_process_left_behind_goes_with_it(scene):
    stage = scene(
        {
            "a": (
                "import subprocess, sys\n"
                "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])\n"
                "print(child.pid, flush=True)\n"
                "sys.exit(1)"
            )
        },
        a=NodeSpec(module="m", restart="never"),
    )
    stage.until(lambda: stage.state("a") is State.FAILED)
    orphan = int((stage.logs / "a.log").read_text())
    stage.until(lambda: not alive(orphan))


def test_nothing_starts_while_everything_ends(scene):
    stage = scene({"a": SLEEPS, "b": SLEEPS}, b=NodeSpec(module="m", after=("a",)))
    stage.until(lambda: stage.state("a") is State.STARTING)
    stage.supervisor.stop()
    stage.ready = {"a"}
    stage.until(lambda: stage.supervisor.over)
    assert stage.said("b") == []


def test_what_fails_while_everything_ends_is_not_started_again(scene):
    stage = scene({"back_off": "import sys; sys.exit(1)", "killed": STUBBORN, "last": POLITE})
    stage.until(lambda: stage.wrote("killed", "up\n") and stage.wrote("last", "up\n"))
    stage.until(lambda: stage.state("back_off") is State.BACKOFF and stage.children["back_off"].restarts > 1)
    started = stage.said("back_off").count("starts again")
    stage.supervisor.stop()
    os.kill(stage.children["killed"].pid, signal.SIGKILL)
    stage.until(lambda: stage.supervisor.over)
    assert stage.said("killed") == ["starts", "killed by SIGKILL"]
    assert stage.said("back_off").count("starts again") == started
