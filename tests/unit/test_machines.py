"""Which machine of a run this is: said by its name, and refused in a sentence where it is none."""

import os
import textwrap

import pytest

from runtime import graph
from runtime.access import keys
from runtime.cli import main
from runtime.errors import ConfigError
from runtime.supervision import machines
from runtime.supervision.machines import Machine, this_machine
from runtime.supervision.supervisor import HUB, commands

SPLIT = """
    robot: rover
    hosts: [pi, desk-2]
    nodes:
      laser: {module: laser, after: [matcher]}
      matcher: {module: matcher, host: desk-2}
      mapper: {module: mapper, host: desk-2}
      base: {module: base, host: pi}
"""


@pytest.fixture
def split(tmp_path):
    return loaded(tmp_path, SPLIT)


def loaded(folder, text):
    file = folder / "g.yaml"
    file.write_text(textwrap.dedent(text))
    return graph.load(file)


def test_each_machine_runs_its_part_and_says_what_it_expects_from_elsewhere(split):
    pi, desk = this_machine(split, "pi"), this_machine(split, "desk-2")
    assert (pi.is_robot, desk.is_robot) == (True, False)
    assert pi.expected() == "matcher, mapper from desk-2"
    assert desk.expected() == "laser, base from pi"
    assert (pi.mark, desk.mark) == ("", "_desk_2")


def test_a_machine_is_found_by_its_own_name(tmp_path):
    own = os.uname().nodename
    split = loaded(tmp_path, f"hosts: [pi, '{own}']\nnodes: {{a: {{module: m}}, b: {{module: m, host: pi}}}}")
    assert this_machine(split) == Machine(own, "pi", {"a": "pi", "b": "pi"})


def test_a_graph_of_one_machine_runs_there_whatever_that_is_called(tmp_path):
    alone = this_machine(loaded(tmp_path, "nodes: {a: {module: m}}"))
    assert (alone.is_robot, alone.elsewhere, alone.mark) == (True, {}, "")


@pytest.mark.parametrize(
    ("text", "named", "error"),
    [
        (SPLIT, None, "and the graph names pi, desk-2: say which it is with --host NAME"),
        (SPLIT, "dask", "--host dask: no machine of the graph, which names pi, desk-2"),
        ("nodes: {a: {module: m}}", "pi", "--host pi: the graph names no machines; list them under hosts"),
    ],
)
def test_a_machine_that_the_graph_does_not_name_starts_nothing(tmp_path, text, named, error):
    with pytest.raises(ConfigError, match=error):
        this_machine(loaded(tmp_path, text), named)


def test_guests_are_let_in_on_the_robot_s_own_machine(split, tmp_path, capsys):
    assert main(["up", str(tmp_path / "g.yaml"), "--headless", "--host", "desk-2", "--remote"]) == 2
    assert "--remote: guests are let in on the robot's own machine, pi" in capsys.readouterr().err


def test_another_machine_needs_a_key_of_its_role(split, tmp_path, monkeypatch):
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "keys"))
    desk = this_machine(split, "desk-2")
    with pytest.raises(ConfigError, match="'desk-2' is not paired with robot 'rover'; on pi: hallway keys"):
        machines.invitation("rover", desk)
    keys.make("rover")
    for role in ("operator", "machine"):
        file = tmp_path / f"{role}.invitation"
        keys.write_private(file, keys.invite("rover", role, role, "10.0.0.1").to_bytes())
        keys.pair(file)
        if role == "operator":
            with pytest.raises(ConfigError, match="'desk-2' is paired with robot 'rover' as operator; on pi"):
                machines.invitation("rover", desk)
    assert machines.invitation("rover", desk).address == "10.0.0.1:7448"


def test_the_robot_s_hub_lets_in_and_the_other_s_leads_there(split, tmp_path):
    robots = commands(split, tmp_path / "g.yaml", tmp_path, tmp_path, remote="0.0.0.0:7448")[HUB]
    others = commands(split, tmp_path / "g.yaml", tmp_path, tmp_path, lead=True)[HUB]
    assert robots[robots.index("--remote") + 1] == "0.0.0.0:7448"
    assert "--lead" in others
    assert "--remote" not in others
    assert others[others.index("--robot") + 1] == "rover"
