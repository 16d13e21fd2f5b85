"""One process under supervision: its start, its clock, its log, and the reason of its end."""

import subprocess
import sys
from pathlib import Path

from runtime.clock import OFFSET_VARIABLE, Clock
from runtime.graph import NodeSpec
from runtime.supervision.child import State, last_line
from runtime.supervision.supervisor import child_environment
from tests.integration.supervised import SLEEPS


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
