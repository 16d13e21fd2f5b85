"""A graph is checked in full before anything starts, and every mistake is one line."""

import json
import sys
import textwrap

import pytest

from runtime import graph
from runtime.cli import main
from runtime.errors import ConfigError
from runtime.graph_on_map import on_map


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """A package of two small nodes that graphs may name."""
    package = tmp_path / "graph_nodes"
    package.mkdir()
    text = """
        from dataclasses import dataclass
        SUBSCRIBES = {reads}
        PUBLISHES = {writes}
        @dataclass(frozen=True, slots=True, kw_only=True)
        class Config:
            gain: float = 1.0
            port: str = ""
            def __post_init__(self):
                if self.gain <= 0:
                    raise ValueError(f"gain = {{self.gain}}, must be more than 0")
        def run(port, config):
            return 0
    """
    for name, reads, writes in (("eye", (), ("scan",)), ("mind", ("scan",), ("odom", "tf"))):
        (package / f"{name}.py").write_text(textwrap.dedent(text.format(reads=reads, writes=writes)))
    (package / "rock.py").write_text("")
    (package / "poor.py").write_text("import a_library_that_is_not_there\n")
    (package / "odd.py").write_text(textwrap.dedent(text.format(reads=("scam",), writes=())))
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith("graph_nodes")]:
        del sys.modules[name]


def written(folder, text):
    file = folder / "g.yaml"
    file.write_text(textwrap.dedent(text))
    return file


def check(folder, text):
    file = written(folder, text)
    return graph.resolve_all(graph.load(file), "g.yaml")


def test_a_good_graph_is_resolved(modules):
    resolved = check(
        modules,
        """
        robot: rover
        nodes:
          mind: {module: graph_nodes.mind}
          eye: {module: graph_nodes.eye, after: [mind], config: {gain: 2, port: "{run}/laser"}}
        """,
    )
    assert list(resolved) == ["mind", "eye"]
    assert resolved["eye"].config.gain == 2.0
    assert resolved["eye"].config.port == "/run/laser"
    assert resolved["mind"].subscribes == ("scan",)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("nodes: {}", "nodes: must name at least one process"),
        ("{}", "nodes is missing"),
        ("nodes: {a: {nice: 1}}", "nodes.a: module is missing"),
        ("robt: x\nnodes: {a: {module: m}}", "robt: unknown key; did you mean 'robot'?"),
        ("robot: Big\nnodes: {a: {module: m}}", "robot = 'Big', must be lower-case"),
        ("seed: -1\nnodes: {a: {module: m}}", "seed = -1, must be in [0, 2^63)"),
        ("domain: 300\nnodes: {a: {module: m}}", "domain = 300, must be in [0, 232]"),
        ("nodes: {a: {modul: m}}", "nodes.a.modul: unknown key; did you mean 'module'?"),
        ("nodes: {A: {module: m}}", "nodes.A: a name must be lower-case"),
        ("nodes: {hub: {module: m}}", "nodes.hub: a name"),
        ("nodes: {a: {module: m, restart: sometimes}}", "restart = 'sometimes', must be one of 'never'"),
        ("nodes: {a: {module: m, priority: 99}}", "nodes.a: priority = 99, must be in [0, 50]"),
        ("nodes: {a: {module: m, nice: -5}}", "nodes.a: nice = -5, must be in [0, 19]"),
        ("nodes: {a: {module: m, cores: [-1]}}", "cores = [-1], must not be negative"),
        ("nodes: {a: {module: m, start_s: 0}}", "start_s = 0.0, must be in (0, 600]"),
        ("nodes: {a: {module: m, turn_s: 0}}", "turn_s = 0.0, must be in (0, 600]"),
        ("nodes: {a: {module: m, stop_s: 0}}", "stop_s = 0.0, must be in (0, 600]"),
        (
            "hosts: [pi, desk]\nnodes: {a: {module: m, host: dsk}}",
            "nodes.a.host: dsk: unknown machine, not among hosts; did you mean 'desk'?",
        ),
        ("nodes: {a: {module: m, host: desk}}", "desk: unknown machine, not among hosts; known: none"),
        ("hosts: [pi, pi]\nnodes: {a: {module: m}}", "hosts: 'pi', must be different names of machines"),
        ("hosts: ['my desk']\nnodes: {a: {module: m}}", "hosts: 'my desk', must be different names"),
        (
            "nodes: {mapper: {module: m}, b: {module: m, after: [maper]}}",
            "after.maper: unknown key; did you mean",
        ),
        ("nodes: {a: {module: m, after: [a]}}", "nodes.a.after.a: unknown key"),
        (
            "nodes: {a: {module: m, after: [c]}, b: {module: m, after: [a]}, c: {module: m, after: [b]}}",
            "after: a cycle, ",
        ),
    ],
)
def test_what_is_written_wrong_is_named(tmp_path, text, error):
    with pytest.raises(ConfigError) as caught:
        graph.load(written(tmp_path, text))
    assert error in str(caught.value)
    assert "g.yaml" in str(caught.value)


@pytest.mark.parametrize(
    ("nodes", "error"),
    [
        ("a: {module: graph_nodes.nose}", "nodes.a.module = 'graph_nodes.nose': no such module"),
        ("a: {module: monitr}", "nodes.a.module.monitr: unknown key; did you mean 'monitor'?"),
        ("a: {module: graph_nodes.rock}", "is no node, it has no Config"),
        ("a: {module: graph_nodes.poor}", "needs 'a_library_that_is_not_there', which is not installed"),
        (
            "a: {module: graph_nodes.odd}",
            "graph_nodes.odd.SUBSCRIBES.scam: unknown key; did you mean 'scan'?",
        ),
        ("a: {module: graph_nodes.eye, config: {gian: 1}}", "nodes.a.config.gian: unknown key; did you mean"),
        (
            "a: {module: graph_nodes.eye, config: {gain: 0}}",
            "nodes.a.config: gain = 0.0, must be more than 0",
        ),
        (
            "a: {module: graph_nodes.eye}, b: {module: graph_nodes.eye}",
            "nodes.b: topic 'scan' is published by 'a' already",
        ),
    ],
)
def test_what_is_wrong_with_a_module_is_named(modules, nodes, error):
    with pytest.raises(ConfigError) as caught:
        check(modules, f"nodes: {{{nodes}}}")
    assert error in str(caught.value)


def test_a_shared_topic_may_have_two_publishers(modules):
    (modules / "graph_nodes" / "soul.py").write_text(
        (modules / "graph_nodes" / "mind.py").read_text().replace("('odom', 'tf')", "('tf',)")
    )
    assert len(check(modules, "nodes: {a: {module: graph_nodes.mind}, b: {module: graph_nodes.soul}}")) == 2


SPLIT = "hosts: [pi, desk]\nnodes: {{eye: {{module: graph_nodes.eye{}}}, mind: {{module: {}, host: desk}}}}"


def test_what_devices_say_is_said_on_the_robot_s_own_machine(modules):
    assert len(check(modules, SPLIT.format(", host: pi", "graph_nodes.mind"))) == 2
    with pytest.raises(ConfigError) as caught:
        check(modules, SPLIT.format(", host: desk", "graph_nodes.mind"))
    assert "nodes.eye.host = 'desk': topic 'scan' is published on the robot's own machine alone, pi" in str(
        caught.value
    )


def test_what_runs_elsewhere_needs_no_library_here(modules, capsys):
    file = written(modules, SPLIT.format("", "graph_nodes.poor"))
    assert graph.main([str(file)]) == 2
    assert "nodes.mind.module" in capsys.readouterr().err
    assert graph.main([str(file), "--elsewhere", "mind"]) == 0
    assert list(json.loads(capsys.readouterr().out)) == ["eye"]


def test_nodes_start_after_those_they_wait_for_and_otherwise_as_written(tmp_path):
    loaded = graph.load(
        written(
            tmp_path, "nodes: {d: {module: m, after: [b]}, c: {module: m}, b: {module: m}, a: {module: m}}"
        )
    )
    assert loaded.order() == ["c", "b", "a", "d"]


def test_without_a_screen_nobody_waits_for_what_is_left_out(tmp_path):
    loaded = graph.load(
        written(tmp_path, "nodes: {v: {module: m, screen: true}, a: {module: m, after: [v]}, b: {module: m}}")
    )
    assert loaded.without_screen().nodes["a"].after == ()
    assert list(loaded.without_screen().nodes) == ["a", "b"]


def test_a_graph_is_found_by_path_or_by_our_name_for_it(tmp_path):
    file = written(tmp_path, "nodes: {a: {module: m}}")
    assert graph.find(str(file)) == file
    assert graph.find("demo") == graph.launch_dir() / "demo.yaml"
    with pytest.raises(ConfigError, match=r"graph 'dmeo': no such file, and not one of ours: demo"):
        graph.find("dmeo")


def test_what_a_laser_in_a_hand_needs_is_what_the_robot_has_without_its_base():
    robot, hand = (graph.load(graph.find(name)) for name in ("onboard", "handheld"))
    assert hand.nodes == {name: node for name, node in robot.nodes.items() if name != "base"}


@pytest.mark.parametrize("name", graph.ours())
def test_each_of_our_graphs_may_start_and_the_help_names_it(name, capsys):
    resolved = graph.resolve_all(graph.load(graph.find(name)), name)
    assert {"laser", "matcher", "mapper"} <= set(resolved)
    with pytest.raises(SystemExit):
        main(["up", "--help"])
    assert name in capsys.readouterr().out


def test_the_check_prints_the_resolved_graph_or_one_line(modules, capsys):
    file = written(modules, "nodes: {eye: {module: graph_nodes.eye}}")
    assert graph.main([str(file)]) == 0
    assert '"gain": 1.0' in capsys.readouterr().out
    file.write_text("nodes: {eye: {module: graph_nodes.eye, config: {gain: -1}}}")
    assert graph.main([str(file)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_graph_begins_on_a_saved_map(tmp_path):
    session = tmp_path / "day1"
    session.mkdir()
    (session / "session.mcap").write_bytes(b"")
    file = graph.find("demo")
    derived = on_map(file, session, True, tmp_path)
    before, after = graph.load(file), graph.load(derived)
    assert after.nodes["mapper"].config == {"session": str(session), "extend": True}
    assert {name: node for name, node in after.nodes.items() if name != "mapper"} == {
        name: node for name, node in before.nodes.items() if name != "mapper"
    }
    assert derived.name == file.name


def test_a_saved_map_that_nobody_takes_is_refused(tmp_path):
    lone = tmp_path / "lone.yaml"
    lone.write_text("nodes:\n  base: {module: base}\n")
    with pytest.raises(ConfigError, match="no mapper"):
        on_map(lone, tmp_path, False, tmp_path / "out")
