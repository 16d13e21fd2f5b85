"""Real processes under supervision: started in order, started again, given up, and all gone in the end."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from runtime.clock import OFFSET_VARIABLE, Clock
from runtime.graph import Graph, NodeSpec
from runtime.process import realtime
from runtime.supervision.child import State, last_line
from runtime.supervision.supervisor import Supervisor, child_environment

SLEEPS = "import time; time.sleep(600)"
POLITE = (
    "import signal, sys, time\n"
    "signal.signal(signal.SIGINT, lambda *_: sys.exit(0))\n"
    "print('up', flush=True)\n"
    "time.sleep(600)"
)
STUBBORN = (
    "import signal, time\n"
    "for number in (signal.SIGINT, signal.SIGTERM):\n"
    "    signal.signal(number, signal.SIG_IGN)\n"
    "print('up', flush=True)\n"
    "while True: time.sleep(600)"
)


class Scene:
    """A supervisor over one-line programs; the test says who is ready."""

    def __init__(self, folder, programs, elsewhere=(), **specs):
        self.logs = folder / "logs"
        self.events = []
        self.forgotten = []
        self.clock = Clock()
        nodes = {name: specs.get(name, NodeSpec(module="m")) for name in programs}
        self.supervisor = Supervisor(
            Graph(nodes=nodes),
            {name: [sys.executable, "-c", text] for name, text in programs.items()},
            self.logs,
            self.clock,
            lambda event: self.events.append((event.node, event.text)),
            self.forgotten.append,
            elsewhere,
        )
        self.children = self.supervisor.children
        self.ready, self.silent, self.loop_ages_s = set(), set(), {}

    def until(self, condition, within_s=20.0):
        end = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < end, self.events
            self.supervisor.step(self.ready, self.silent, self.loop_ages_s)
            time.sleep(0.01)

    def state(self, name):
        return self.children[name].state

    def wrote(self, name, text):
        log = self.logs / f"{name}.log"
        return log.exists() and log.read_text() == text

    def said(self, name):
        return [text for node, text in self.events if node == name]


@pytest.fixture
def scene(tmp_path):
    made = []

    def make(programs, **how):
        made.append(Scene(tmp_path, programs, **how))
        return made[-1]

    yield make
    for one in made:
        one.supervisor.close()
        assert all(child.pid is None for child in one.children.values())


def alive(pid):
    with contextlib.suppress(ProcessLookupError, FileNotFoundError):
        os.kill(pid, 0)
        with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    return False


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


def test_what_cannot_be_started_for_want_of_something_is_tried_again(scene, monkeypatch):
    lacking = iter([OSError(12, "Cannot allocate memory")] * 2)

    def popen(*args, **kwargs):
        if (error := next(lacking, None)) is not None:
            raise error
        return really(*args, **kwargs)

    really = subprocess.Popen
    monkeypatch.setattr("runtime.supervision.child.subprocess.Popen", popen)
    stage = scene({"a": SLEEPS})
    stage.until(lambda: stage.state("a") is State.STARTING)
    why = "cannot be started: Cannot allocate memory"
    assert stage.said("a") == [
        f"{why}; starts again in 0 s",
        f"{why}; starts again in 0.25 s",
        "starts again",
    ]


def test_a_signal_without_a_name_is_told_by_its_number(scene):
    stage = scene({"a": "import os; os.kill(os.getpid(), 40)"}, a=NodeSpec(module="m", restart="never"))
    stage.until(lambda: stage.state("a") is State.FAILED)
    assert stage.said("a")[-1] == "killed by signal 40"


def test_every_process_has_the_clock_of_the_run_and_one_thread_for_numbers(scene):
    stage = scene({"a": f"import os; print(os.environ[{OFFSET_VARIABLE!r}], os.environ['OMP_NUM_THREADS'])"})
    stage.until(lambda: stage.state("a") is State.ENDED)
    assert (stage.logs / "a.log").read_text() == f"{stage.clock.offset_ns} 1\n"


def test_logs_are_cut_before_they_fill_the_disk(scene, monkeypatch):
    monkeypatch.setattr("runtime.supervision.child._LOG_BYTES", 100)
    stage = scene({"a": SLEEPS})
    stage.until(lambda: stage.state("a") is State.STARTING)
    child = stage.children["a"]
    for number in range(6):
        with child.log_path.open("a") as log:
            log.write(f"{number}" * 120 + "\n")
        child.rotate_log()
    assert child.log_path.read_text() == ""
    kept = sorted(path.name for path in stage.logs.iterdir())
    assert kept == ["a.log", "a.log.1", "a.log.2", "a.log.3"]
    assert (stage.logs / "a.log.1").read_text().startswith("5")
    assert (stage.logs / "a.log.3").read_text().startswith("3")


def test_a_full_disk_costs_the_logs_and_not_the_robot(scene, monkeypatch):
    def full(*paths):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("runtime.supervision.child._LOG_BYTES", 100)
    monkeypatch.setattr("runtime.supervision.child.shutil.copyfile", full)
    stage = scene({"a": SLEEPS})
    stage.until(lambda: stage.state("a") is State.STARTING)
    child = stage.children["a"]
    child.log_path.write_text("x" * 200)
    child.rotate_log()
    assert child.log_path.read_text() == ""


def test_the_reason_is_the_last_line_without_its_time_and_name(tmp_path):
    log = tmp_path / "a.log"
    log.write_text("x\n2025-01-01T00:00:00.000 ERROR   laser: /dev/ttyACM0: no such device\n")
    assert last_line(log) == "/dev/ttyACM0: no such device"
    assert last_line(tmp_path / "none.log") == ""


def test_a_folder_called_runtime_where_the_person_stands_is_not_taken_for_ours(tmp_path, monkeypatch):
    for name in ("runtime", "theirs"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    monkeypatch.chdir(tmp_path)
    words = "import runtime, theirs; print(runtime.__file__); print(theirs.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", words], env=child_environment(Clock()), capture_output=True, text=True
    )
    ours, theirs = done.stdout.split()
    assert Path(ours) == Path(__file__).parents[2] / "runtime" / "__init__.py"
    assert Path(theirs) == tmp_path / "theirs" / "__init__.py"
