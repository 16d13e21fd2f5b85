"""YAML and frozen dataclasses: the only module that reads or writes YAML.

Every error is a `ConfigError` that names place, rule and value; an unknown key comes with a guess.
"""

import dataclasses
import enum
import math
import textwrap
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

import yaml

from runtime.errors import ConfigError
from runtime.guess import meant

T = TypeVar("T")


def refuse_unknown(
    keys: typing.Iterable[Any], known: typing.Collection[str], where: str, *, what: str = "key"
) -> None:
    """Raise ConfigError, with a guess, for the first key that is not among the known ones.

    Args:
        keys: What was written.
        known: What may be.
        where: Its place.
        what: The word for one of them.
    """
    for key in keys:
        if key not in known:
            hint = meant(key, known) or f"; known: {', '.join(sorted(known)) or 'none'}"
            place = f"{where}.{key}" if what == "key" else f"{where} {key}"
            raise ConfigError(f"{place}: unknown {what}{hint}")


def build(cls: type[T], data: Mapping[str, Any] | None, where: str = "config") -> T:
    """Check a plain mapping against the fields of the dataclass `cls` and build it; raises ConfigError."""
    if not isinstance(data := {} if data is None else data, Mapping):
        raise ConfigError(f"{where}: must be a mapping of {cls.__name__}, got {data!r}")
    hints = typing.get_type_hints(cls)
    fields = [f for f in dataclasses.fields(cls) if f.init]  # type: ignore[arg-type]
    refuse_unknown(data, [f.name for f in fields], where)
    for field in fields:
        required = field.default is field.default_factory is dataclasses.MISSING
        if required and field.name not in data:
            raise ConfigError(f"{where}: {field.name} is missing")
    values = {name: _value(hints[name], value, f"{where}.{name}") for name, value in data.items()}
    try:
        return cls(**values)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where}: {error}") from error


def _value(hint: Any, value: Any, where: str) -> Any:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in args:
            return None
        return _value(next(arg for arg in args if arg is not type(None)), value, where)
    if hint is Any:
        return value
    if origin is Literal:
        if value not in args:
            raise ConfigError(f"{where} = {value!r}, must be one of {', '.join(map(repr, args))}")
        return value
    if origin in (tuple, list) and isinstance(value, (list, tuple)):
        if origin is list or args[-1] is Ellipsis:
            args = (args[0],) * len(value)
        if len(args) != len(value):
            raise ConfigError(f"{where} = {value!r}, must have {len(args)} values")
        pairs = enumerate(zip(args, value, strict=True))
        return origin(_value(arg, item, f"{where}[{i}]") for i, (arg, item) in pairs)
    if origin is dict and isinstance(value, Mapping):
        return {str(key): _value(args[1], item, f"{where}.{key}") for key, item in value.items()}
    if dataclasses.is_dataclass(hint):
        return build(typing.cast(type, hint), value, where)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        named = {str(member.value): member for member in hint} | {member.name: member for member in hint}
        if str(value) not in named:
            raise ConfigError(f"{where} = {value!r}, must be one of {', '.join(m.name for m in hint)}")
        return named[str(value)]
    if hint is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        if math.isnan(value):
            raise ConfigError(f"{where} = {value!r}, must be a number")
        return float(value)
    if hint is Path and isinstance(value, str):
        return Path(value)
    if isinstance(hint, type) and isinstance(value, hint) and not (hint is int and isinstance(value, bool)):
        return value
    raise ConfigError(f"{where} = {value!r}, must be {getattr(origin or hint, '__name__', hint)}")


def plain(value: Any) -> Any:
    """Turn dataclasses, enums, paths and tuples into what YAML and JSON can hold."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


class _Strict(yaml.SafeLoader):
    """YAML in which a key given twice is an error, not a silent choice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        if twice := [key for i, key in enumerate(keys) if key in keys[:i]]:
            problem = f"key {twice[0]!r} given twice"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return super().construct_mapping(node, deep)


def load_yaml(path: Path) -> Any:
    """Read a YAML file; raises ConfigError with the line where it is broken."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not text: byte 0x{error.object[error.start]:02x} found") from error
    return parse_yaml(text, str(path))


def parse_yaml(text: str, where: str) -> Any:
    """Read YAML that came from elsewhere; raises ConfigError with the line where it is broken."""
    try:
        return yaml.load(text, Loader=_Strict)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        raise ConfigError(f"{where}:{line}: not YAML: {error.problem}") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"{where}: not YAML: {error}") from error


def load(cls: type[T], path: Path, section: str | None = None) -> T:
    """Read a configuration from a file, or from one section of it, which must be there."""
    data = load_yaml(path)
    if section is None:
        return build(cls, data, str(path))
    if not isinstance(data, Mapping) or section not in data:
        raise ConfigError(f"{path}: section {section!r} is missing")
    return build(cls, data[section], f"{path}: {section}")


def annotated_yaml(value: Mapping[str, Any], notes: Mapping[str, str], inside: str = "") -> str:
    """Write nested mappings as YAML, one line for each value, with a comment behind it.

    Args:
        value: As `plain` returns it.
        notes: The comments, by the keys from the outermost mapping inwards, joined with dots.
        inside: Place of `value` itself.
    """
    lines = []
    for key, item in value.items():
        place = f"{inside}.{key}" if inside else key
        if isinstance(item, Mapping) and item:
            block = annotated_yaml(item, notes, place)
            lines.append(f"{key}:\n{textwrap.indent(block, '  ')}")
        else:
            line = f"{in_yaml(key)}: {in_yaml(item)}"
            lines.append(f"{line}  # {notes[place]}\n" if notes.get(place) else f"{line}\n")
    return "".join(lines)


def in_yaml(item: Any) -> str:
    """Write one plain value as it stands behind a key, in one line."""
    flow = yaml.safe_dump([item], default_flow_style=True, width=math.inf, allow_unicode=True)
    return str(flow).strip()[1:-1]


def to_yaml(value: Any) -> str:
    """Write a configuration, or any plain value, as YAML in the order of its fields."""
    return str(yaml.safe_dump(plain(value), sort_keys=False, allow_unicode=True))
