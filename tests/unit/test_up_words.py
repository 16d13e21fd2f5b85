"""What `hallway up` says when a process ends the run: its reason once, as the last word, with the way out."""

from types import SimpleNamespace

import pytest

from runtime.cli import up, up_end
from runtime.errors import ConfigError
from runtime.graph import NodeSpec
from runtime.supervision.child import State
from runtime.supervision.machines import Machine
from runtime.supervision.supervisor import Event

MISSING = "exit code 3: /dev/ttyUSB0: no such port"


def child(name, state=State.FAILED, *, module="base", exit_code=3, required=True):
    spec = NodeSpec(module=module, required=required)
    return SimpleNamespace(name=name, state=state, spec=spec, exit_code=exit_code, reasons=[MISSING])


@pytest.mark.parametrize(
    ("failed", "hint"),
    [
        (child("base"), True),
        (child("wheels"), True),
        (child("base", exit_code=1), False),
        (child("laser", module="laser"), False),
    ],
)
def test_who_has_no_robot_is_told_how_to_do_without(failed, hint):
    reason = up_end._reason(failed)
    assert reason.startswith(f"{failed.name}: {MISSING}")
    assert ("hallway up handheld" in reason) is hint


def test_a_run_that_did_not_fail_has_no_reason():
    assert up_end._reason(None) == ""


@pytest.mark.parametrize(
    ("there", "said"),
    [
        (child("base"), "failed, and ends the run"),
        (child("base", required=False), MISSING),
        (child("base", State.BACKOFF), MISSING),
    ],
)
def test_the_reason_that_ends_a_run_is_kept_for_the_last_word(there, said):
    live = SimpleNamespace(supervisor=SimpleNamespace(children={"base": there}))
    assert up_end.in_short(live, Event(0, "base", MISSING)) == said


def test_the_summary_does_not_repeat_the_reason(tmp_path, capsys):
    process = {"state": "failed", "restarts": 0, "reasons": [MISSING]}
    report = {
        "reason": f"base: {MISSING}",
        "out": str(tmp_path),
        "metrics": {},
        "processes": {"base": process},
    }
    up_end.say(report, False)
    out, err = capsys.readouterr()
    assert (out + err).count("no such port") == 1
    process["restarts"] = 5
    up_end.say(report, False)
    out, err = capsys.readouterr()
    assert "base: 5 restarts\n" in out
    report["reason"] = ""
    up_end.say(report, False)
    assert f"base: 5 restarts, last: {MISSING}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("asked", "door"),
    [
        (None, ""),
        ("", "0.0.0.0:7448"),
        ("0.0.0.0", "0.0.0.0:7448"),
        ("pi", "pi:7448"),
        ("10.0.0.7:99", "10.0.0.7:99"),
    ],
)
def test_guests_come_in_where_asked_and_at_the_usual_port_where_none_is_named(asked, door):
    assert up._door(asked, Machine()) == door


def test_another_machine_of_the_run_comes_in_unasked_and_lets_nobody_in():
    assert up._door(None, Machine("pi", "pi", {"mapper": "desk"})) == "0.0.0.0:7448"
    desk = Machine("desk", "pi", {"laser": "pi"})
    assert up._door(None, desk) == ""
    with pytest.raises(ConfigError, match="let in on the robot's own machine, pi"):
        up._door("", desk)
