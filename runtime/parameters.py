"""What can be set, told from where it is written: the dataclasses of the configuration, and nothing else.

The text under a field says what it means, its name or that text the unit, the errors of `__post_init__` what
it must be.
"""

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin, get_type_hints

_UNITS = {
    "mps2": "m/s²",
    "radps2": "rad/s²",
    "mps": "m/s",
    "m_s": "m/s",
    "radps": "rad/s",
    "rad_s": "rad/s",
    "rad_per_m": "rad/m",
    "rad": "rad",
    "m": "m",
    "ms": "ms",
    "s": "s",
    "v": "V",
    "mb": "MB",
}
_ENDING = re.compile(rf"_({'|'.join(sorted(_UNITS, key=len, reverse=True))})\Z")
_UNIT_SAID = re.compile(r", (m/s|rad/s)[.;]")
_RANGE_SAID = re.compile(r"\b([\d.]+ \.\. [\d.]+)\b")


@dataclass(frozen=True, slots=True, eq=False)
class Parameter:
    """One thing that can be set."""

    name: str
    """From the outermost dataclass inwards, with dots."""
    default: Any
    """`dataclasses.MISSING` where a value is required."""
    unit: str
    """Empty for none."""
    limits: str
    """Empty for none."""
    meaning: str


def parameters(cls: type) -> Iterator[Parameter]:
    """Yield everything that can be set in a dataclass and in those inside it, in the order of its fields."""
    yield from _parameters(cls, "")


def _parameters(cls: type, prefix: str) -> Iterator[Parameter]:
    words, rules, hints = _words(cls), _rules(cls), get_type_hints(cls)
    for field in dataclasses.fields(cls):
        hint, meaning = hints[field.name], words.get(field.name, "")
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            yield from _parameters(hint, f"{prefix}{field.name}.")
            continue
        yield Parameter(
            prefix + field.name,
            _default(field),
            _unit(field.name, meaning),
            _limits(rules, field.name, hint, meaning),
            meaning,
        )


def _default(field: "dataclasses.Field[Any]") -> Any:
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def _unit(name: str, meaning: str) -> str:
    if ending := _ENDING.search(name):
        return _UNITS[ending[1]]
    said = _UNIT_SAID.search(meaning)
    return said[1] if said else ""


def _limits(rules: dict[str, str], name: str, hint: Any, meaning: str) -> str:
    if name in rules:
        return rules[name].removeprefix("not be ").replace("negative", "0 or more")
    if get_origin(hint) is Literal:
        return ", ".join(map(str, get_args(hint)))
    if hint is bool:
        return "true or false"
    said = _RANGE_SAID.search(meaning)
    return said[1] if said else ""


def _words(cls: type) -> dict[str, str]:
    """Return the text that stands under each field."""
    body = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0]
    assert isinstance(body, ast.ClassDef)
    words = {}
    for this, following in zip(body.body, body.body[1:], strict=False):
        if isinstance(this, ast.AnnAssign) and isinstance(this.target, ast.Name):
            text = following.value if isinstance(following, ast.Expr) else None
            if isinstance(text, ast.Constant) and isinstance(text.value, str):
                words[this.target.id] = " ".join(text.value.split())
    return words


def _rules(cls: type) -> dict[str, str]:
    """Return what each field must be, from the errors that say so and from tables of least and greatest."""
    check = getattr(cls, "__post_init__", None)
    if check is None:
        return {}
    source = inspect.getsource(check)
    said = re.findall(r'"(\w+(?:, \w+)*) = [^"]*?, must (?:be )?([^"{}]*)"', source)
    rules = {name: rule for names, rule in said for name in names.split(", ")}
    # One rule for several fields: for name in ("a", "b"): ... f"{name} = ..., must be ..."
    loops = re.findall(r'for (\w+) in \(([^)]*)\):(.*?)must (?:be )?([^"{}]*)"', source, flags=re.DOTALL)
    for _, names, _, rule in loops:
        rules |= {name: rule for name in re.findall(r'"(\w+)"', names) if name not in rules}
    return _tabled(cls) | rules


def _tabled(cls: type) -> dict[str, str]:
    """Return the rules of tables {"name": (low, high)} in the module of a class, of its fields alone."""
    module = inspect.getmodule(cls)
    names = {field.name for field in dataclasses.fields(cls)}
    rules = {}
    for table in ast.walk(ast.parse(inspect.getsource(module) if module else "")):
        if not isinstance(table, ast.Dict) or not table.keys:
            continue
        keys = [key.value for key in table.keys if isinstance(key, ast.Constant)]
        if len(keys) != len(table.keys) or not names.issuperset(keys):
            continue
        for key, pair in zip(keys, table.values, strict=True):
            if isinstance(pair, ast.Tuple) and len(pair.elts) == 2:
                low, high = map(ast.literal_eval, pair.elts)
                rules[str(key)] = f"in [{low:g}, {high:g}]"
    return rules
