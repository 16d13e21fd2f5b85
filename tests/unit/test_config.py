"""Every wrong configuration is one line of place, rule and value."""

import enum
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from runtime import config
from runtime.errors import ConfigError


class Colour(enum.Enum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True, slots=True, kw_only=True)
class Inner:
    radius_m: float = 0.5

    def __post_init__(self):
        if not 0 < self.radius_m <= 2:
            raise ValueError(f"radius_m = {self.radius_m}, must be in (0, 2]")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outer:
    count: int = 1
    ratio: float = 0.5
    name: str = "x"
    loud: bool = False
    file: Path = Path("a")
    colour: Colour = Colour.RED
    mode: Literal["fast", "slow"] = "fast"
    pair: tuple[float, float] = (0.0, 1.0)
    several: tuple[int, ...] = ()
    words: list[str] = field(default_factory=list)
    maybe: float | None = None
    inner: Inner = field(default_factory=Inner)
    parts: dict[str, Inner] = field(default_factory=dict)


def test_nothing_given_means_the_defaults():
    assert config.build(Outer, {}) == Outer()
    assert config.build(Outer, None) == Outer()


def test_every_kind_of_value_is_taken():
    built = config.build(
        Outer,
        {
            "count": 3,
            "ratio": 1,
            "loud": True,
            "file": "/b",
            "colour": "blue",
            "mode": "slow",
            "pair": [1, 2.5],
            "several": [1, 2],
            "words": ["a"],
            "maybe": 2,
            "inner": {"radius_m": 1},
            "parts": {"left": {}, "right": {"radius_m": 2.0}},
        },
    )
    assert built == Outer(
        count=3,
        ratio=1.0,
        loud=True,
        file=Path("/b"),
        colour=Colour.BLUE,
        mode="slow",
        pair=(1.0, 2.5),
        several=(1, 2),
        words=["a"],
        maybe=2.0,
        inner=Inner(radius_m=1.0),
        parts={"left": Inner(), "right": Inner(radius_m=2.0)},
    )
    assert isinstance(built.ratio, float)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ({"cuont": 1}, "config.cuont: unknown key; did you mean 'count'?"),
        ({"zzz": 1}, "config.zzz: unknown key; known: colour, count"),
        ({"count": 1.5}, "config.count = 1.5, must be int"),
        ({"count": True}, "config.count = True, must be int"),
        ({"count": "1"}, "config.count = '1', must be int"),
        ({"ratio": True}, "config.ratio = True, must be float"),
        ({"loud": 1}, "config.loud = 1, must be bool"),
        ({"name": 3}, "config.name = 3, must be str"),
        ({"colour": "green"}, "config.colour = 'green', must be one of RED, BLUE"),
        ({"mode": "medium"}, "config.mode = 'medium', must be one of 'fast', 'slow'"),
        ({"pair": [1]}, "config.pair = [1], must have 2 values"),
        ({"pair": 1}, "config.pair = 1, must be tuple"),
        ({"several": [1, "a"]}, "config.several[1] = 'a', must be int"),
        ({"inner": {"radius_m": 3}}, "config.inner: radius_m = 3.0, must be in (0, 2]"),
        ({"inner": {"radius": 1}}, "config.inner.radius: unknown key; did you mean 'radius_m'?"),
        ({"parts": {"left": {"radius_m": 0}}}, "config.parts.left: radius_m = 0.0, must be in (0, 2]"),
        ({"inner": 3}, "config.inner: must be a mapping of Inner, got 3"),
        ([1], "config: must be a mapping of Outer, got [1]"),
    ],
)
def test_a_wrong_value_names_place_rule_and_value(data, text):
    with pytest.raises(ConfigError) as caught:
        config.build(Outer, data)
    assert str(caught.value).startswith(text)


def test_what_is_unknown_is_called_what_it_is():
    known = ["corridor", "loop"]
    with pytest.raises(ConfigError, match="--buildings coridor: unknown building; did you mean 'corr"):
        config.refuse_unknown(["coridor"], known, "--buildings", what="building")
    with pytest.raises(ConfigError, match="--buildings hut: unknown building; known: corridor, loop"):
        config.refuse_unknown(["hut"], known, "--buildings", what="building")


def test_a_required_value_that_is_not_there_is_named():
    @dataclass
    class Device:
        path: str

    with pytest.raises(ConfigError, match="base: path is missing"):
        config.build(Device, {}, "base")


def test_what_is_dumped_is_what_is_loaded(tmp_path):
    file = tmp_path / "a.yaml"
    value = Outer(file=Path("/b"), colour=Colour.BLUE, pair=(2.0, 3.0), parts={"left": Inner()})
    file.write_text(config.to_yaml(value))
    assert config.load(Outer, file) == value


def test_a_file_that_is_not_there_or_not_yaml_is_one_line_with_its_place(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read: No such file"):
        config.load(Outer, tmp_path / "none.yaml")
    bad = tmp_path / "bad.yaml"
    bad.write_text("count: 1\nname: [1\n")
    with pytest.raises(ConfigError, match=r"bad\.yaml:3: not YAML"):
        config.load(Outer, bad)
    bad.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"bad\.yaml: not text: byte 0xff found"):
        config.load(Outer, bad)


def test_what_is_no_number_is_no_value(tmp_path):
    (tmp_path / "a.yaml").write_text("pair: [1.0, .nan]\n")
    with pytest.raises(ConfigError, match=r"a\.yaml\.pair\[1\] = nan, must be a number"):
        config.load(Outer, tmp_path / "a.yaml")


def test_a_key_given_twice_is_an_error(tmp_path):
    file = tmp_path / "twice.yaml"
    file.write_text("count: 1\ncount: 2\n")
    with pytest.raises(ConfigError, match="key 'count' given twice"):
        config.load(Outer, file)


def test_a_section_that_is_missing_is_an_error_and_not_the_defaults(tmp_path):
    file = tmp_path / "a.yaml"
    file.write_text("innre: {}\n")
    with pytest.raises(ConfigError, match="section 'inner' is missing"):
        config.load(Inner, file, "inner")
    file.write_text("inner: {radius_m: 1}\n")
    assert config.load(Inner, file, "inner") == Inner(radius_m=1.0)
