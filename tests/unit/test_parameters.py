"""What can be set is told with unit, limits and meaning; a dumped graph says whose each value is."""

import dataclasses
from dataclasses import dataclass, field
from typing import Literal

import pytest

from runtime import config, graph
from runtime.cli import main
from runtime.nodes.offline_config import OfflineConfig
from runtime.parameters import parameters

_RANGES = {"speed_mps": (0.1, 2.0), "count": (1, 5)}


@dataclass(frozen=True, kw_only=True)
class Inner:
    speed_mps: float = 1.0
    """How fast."""
    count: int = 3

    def __post_init__(self) -> None:
        for name, (low, high) in _RANGES.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)}, must be in [{low}, {high}]")


@dataclass(frozen=True, kw_only=True)
class Outer:
    path: str
    push: float = 1.0
    """Change of velocity in one second, m/s."""
    skip: int = 0
    """Scans left out, 0 .. 9."""
    near_m: float = 0.1
    far_m: float = 4.0
    mode: Literal["fast", "slow"] = "fast"
    loud: bool = False
    inner: Inner = field(default_factory=Inner)

    def __post_init__(self) -> None:
        if self.push < 0:
            raise ValueError(f"push = {self.push}, must not be negative")
        if self.near_m <= 0 or self.far_m <= 0:
            raise ValueError(f"near_m, far_m = {self.near_m}, {self.far_m}, must be positive")


def test_unit_limits_and_meaning_are_read_where_they_are_written():
    told = {one.name: (one.unit, one.limits, one.meaning) for one in parameters(Outer)}
    assert told == {
        "path": ("", "", ""),
        "push": ("m/s", "0 or more", "Change of velocity in one second, m/s."),
        "skip": ("", "0 .. 9", "Scans left out, 0 .. 9."),
        "near_m": ("m", "positive", ""),
        "far_m": ("m", "positive", ""),
        "mode": ("", "fast, slow", ""),
        "loud": ("", "true or false", ""),
        "inner.speed_mps": ("m/s", "in [0.1, 2]", "How fast."),
        "inner.count": ("", "in [1, 5]", ""),
    }
    defaults = {one.name: one.default for one in parameters(Outer)}
    assert defaults["path"] is dataclasses.MISSING
    assert defaults["inner.count"] == 3


@pytest.fixture(scope="module")
def ours():
    kinds = {graph.Graph, graph.NodeSpec, OfflineConfig}
    for name in graph.ours():
        resolved = graph.resolve_all(graph.load(graph.find(name)), name)
        kinds |= {type(node.config) for node in resolved.values()}
    return [(kind, one) for kind in kinds for one in parameters(kind)]


def test_nothing_of_ours_can_be_set_without_a_word_about_it(ours):
    mute = [f"{kind.__module__}: {one.name}" for kind, one in ours if not (one.limits or one.meaning)]
    assert mute == []


def test_names_that_end_in_a_unit_have_it(ours):
    units = {one.name: one.unit for _, one in ours}
    assert units["safety.turn_acceleration_radps2"] == "rad/s²"
    assert units["odometry.prediction.speed_m_s"] == "m/s"
    assert units["mapping.loops.drift_rad_per_m"] == "rad/m"
    assert units["mapping.particles"] == ""


@pytest.mark.parametrize("name", graph.ours())
def test_a_dumped_graph_is_that_graph_with_every_default(name, capsys, tmp_path):
    assert main(["config", "dump", name]) == 0
    file = tmp_path / "dumped.yaml"
    file.write_text(capsys.readouterr().out)
    before, after = graph.load(graph.find(name)), graph.load(file)
    first, second = (graph.resolve_all(one, name) for one in (before, after))
    assert {key: node.config for key, node in first.items()} == {
        key: node.config for key, node in second.items()
    }
    for node in before.nodes:
        assert dataclasses.replace(after.nodes[node], config={}) == dataclasses.replace(
            before.nodes[node], config={}
        )


def test_a_dumped_value_says_its_limits_and_whose_it_is(capsys, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("nodes:\n  mapper: {module: mapper, config: {mapping: {particles: 80}}}\n")
    assert main(["config", "dump", str(file)]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert "particles: 80  # in [1, 5000]; from the file; default 50" in lines
    assert "key_distance_m: 0.25  # m; in [0.02, 2]; default" in lines
    assert "module: mapper  # from the file" in lines
    assert lines.index("nodes:") > lines.index("seed: 1  # in [0, 2^63); default")


def test_whatever_a_value_is_its_annotated_line_is_read_back():
    value = {
        "a": {"list": [1, 2.5, [3]], "empty": "", "none": None, "inside": {}},
        "odd": ["a, b", "# no comment", "yes", "Ö: ö", "two\nlines"],
        "far": float("inf"),
    }
    notes = {"a.list": "m", "a.inside": "nothing", "odd": "in [0, 1]", "far": "default"}
    text = config.annotated_yaml(value, notes)
    assert config.parse_yaml(text, "here") == value
    assert text.count("#") == 5
