"""A graph of processes: read from YAML and checked in full before anything starts.

`load` checks what is written; `resolve` imports the modules and checks configurations and topics as well.
Every error is a `ConfigError` that names place, rule and value.
"""

import graphlib
import importlib
import os
import pkgutil
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from runtime import config as configuration
from runtime.errors import ConfigError
from runtime.topics import TOPICS

_NAME = re.compile(r"[a-z][a-z0-9_]*\Z")  # what ROS 2 takes as a node's name or namespace
_HOST = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*\Z")
_HOME = "runtime.nodes"
RUN_PLACEHOLDER = "{run}"
"""In a node's configuration: the directory of this run, where emulators put their ports."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSpec:
    """One process of a graph."""

    module: str
    """`matcher` for `runtime.nodes.matcher`, or the dotted name of any module like it."""
    config: dict[str, Any] = field(default_factory=dict)
    """Of the module: the tables below."""
    after: tuple[str, ...] = ()
    """Nodes that must be ready before this one starts."""
    restart: Literal["never", "on-failure", "always"] = "on-failure"
    required: bool = True
    """Whether the run ends when this node has failed for good."""
    screen: bool = False
    """Whether the node shows something, and is left out without a screen."""
    spare: bool = False
    """Whether a second process stands by, everything imported, to take over when the first one dies."""
    priority: int = 0
    """Of SCHED_FIFO, 1 .. 50; 0 for the ordinary scheduler."""
    nice: int = 0
    cores: tuple[int, ...] = ()
    """CPU numbers to stay on; all if empty."""
    start_s: float = 60.0
    """Time to become ready."""
    stop_s: float = 1.8
    """Time to end when asked; a node that has much to save may have more."""
    turn_s: float = 30.0
    """Time for one turn of its loop; after that it hangs, and is started again."""
    host: str = ""
    """The machine that it runs on, one of `hosts`; the robot's own if empty."""

    def __post_init__(self) -> None:
        if not 0 <= self.priority <= 50:
            raise ValueError(f"priority = {self.priority}, must be in [0, 50]")
        if not 0 <= self.nice <= 19:
            raise ValueError(f"nice = {self.nice}, must be in [0, 19]")
        if any(core < 0 for core in self.cores):
            raise ValueError(f"cores = {list(self.cores)}, must not be negative")
        if not 0 < self.start_s <= 600:
            raise ValueError(f"start_s = {self.start_s}, must be in (0, 600]")
        if not 0 < self.stop_s <= 600:
            raise ValueError(f"stop_s = {self.stop_s}, must be in (0, 600]")
        if not 0 < self.turn_s <= 600:
            raise ValueError(f"turn_s = {self.turn_s}, must be in (0, 600]")


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """The processes of one robot."""

    nodes: dict[str, NodeSpec]
    """The processes by name; each has the keys of the next table."""
    robot: str = "robot"
    domain: int = 0
    """ROS domain, 0 .. 232."""
    seed: int = 1
    hosts: tuple[str, ...] = ()
    """Names of the machines that the processes run on, the robot's own first; empty for one machine."""

    def __post_init__(self) -> None:
        if not _NAME.match(self.robot):
            raise ValueError(f"robot = {self.robot!r}, must be lower-case letters, digits and underscores")
        if not 0 <= self.domain <= 232:
            raise ValueError(f"domain = {self.domain}, must be in [0, 232]")
        if not 0 <= self.seed < 2**63:
            raise ValueError(f"seed = {self.seed}, must be in [0, 2^63)")
        if not self.nodes:
            raise ValueError("nodes: must name at least one process")
        for host in self.hosts:
            if not _HOST.match(host) or self.hosts.count(host) > 1:
                raise ValueError(
                    f"hosts: {host!r}, must be different names of machines: letters, digits, . _ -"
                )
        for name, node in self.nodes.items():
            if node.host:
                place, what = f"nodes.{name}.host:", "machine, not among hosts"
                configuration.refuse_unknown([node.host], self.hosts, place, what=what)
            if not _NAME.match(name) or name == "hub":
                raise ValueError(f"nodes.{name}: a name must be lower-case letters, digits and underscores")
            configuration.refuse_unknown(
                node.after, [n for n in self.nodes if n != name], f"nodes.{name}.after"
            )
        self.order()

    def is_away(self, name: str) -> bool:
        """Whether a process runs on another machine than the robot's own."""
        return self.nodes[name].host not in ("", *self.hosts[:1])

    def order(self) -> list[str]:
        """Return the names so that each comes after those it waits for, and otherwise as written."""
        sorter = graphlib.TopologicalSorter({name: node.after for name, node in self.nodes.items()})
        try:
            sorter.prepare()
        except graphlib.CycleError as error:
            raise ValueError(f"after: a cycle, {' -> '.join(reversed(error.args[1]))}") from error
        order: list[str] = []
        written = list(self.nodes)
        while sorter.is_active():
            ready = sorted(sorter.get_ready(), key=written.index)
            order += ready
            sorter.done(*ready)
        return order

    def without_screen(self) -> "Graph":
        """Return the graph without the nodes that show something."""
        shown = {name for name, node in self.nodes.items() if node.screen}
        left = {
            name: replace(node, after=tuple(n for n in node.after if n not in shown))
            for name, node in self.nodes.items()
            if name not in shown
        }
        return replace(self, nodes=left)


@dataclass(frozen=True, slots=True, eq=False)
class Resolved:
    """One node with its module imported and its configuration built."""

    module: ModuleType
    config: Any
    subscribes: tuple[str, ...]
    publishes: tuple[str, ...]


def launch_dir() -> Path:
    """Return where the graphs of this installation are: inside the wheel, or in the checkout."""
    here = Path(__file__).resolve().parent
    return here / "_launch" if (here / "_launch").is_dir() else here.parent / "launch"


def ours() -> list[str]:
    """Return the names of the graphs that we bring."""
    return sorted(path.stem for path in launch_dir().glob("*.yaml"))


def find(name: str) -> Path:
    """Return the file of a graph given by path or by the name of one that we bring; raises ConfigError."""
    path = Path(name)
    if path.is_file():
        return path
    if name in ours():
        return launch_dir() / f"{name}.yaml"
    raise ConfigError(f"graph {name!r}: no such file, and not one of ours: {', '.join(ours()) or 'none'}")


def load(path: Path) -> Graph:
    """Read a graph and check everything but the modules; raises ConfigError."""
    return configuration.load(Graph, path)


def resolve(name: str, node: NodeSpec, where: str, run_dir: Path = Path("/run")) -> Resolved:
    """Import one node's module and build its configuration; raises ConfigError."""
    place = f"{where}: nodes.{name}"
    module = _import(node.module, f"{place}.module")
    config = configuration.build(module.Config, _placed(node.config, run_dir), f"{place}.config")
    subscribes, publishes = tuple(module.SUBSCRIBES), tuple(module.PUBLISHES)
    for listed, topics in (("SUBSCRIBES", subscribes), ("PUBLISHES", publishes)):
        configuration.refuse_unknown(topics, list(TOPICS), f"{module.__name__}.{listed}")
    return Resolved(module, config, subscribes, publishes)


def resolve_all(graph: Graph, where: str, elsewhere: Collection[str] = ()) -> dict[str, Resolved]:
    """Resolve every node that is not `elsewhere` and check who publishes what; raises ConfigError.

    A topic has one publisher, and what devices say is said on the robot's own machine.
    """
    here = {name: node for name, node in graph.nodes.items() if name not in elsewhere}
    resolved = {name: resolve(name, node, where) for name, node in here.items()}
    publishers: dict[str, str] = {}
    for name, node in resolved.items():
        for topic in node.publishes:
            first = publishers.setdefault(topic, name)
            if first != name and not TOPICS[topic].shared:
                raise ConfigError(f"{where}: nodes.{name}: topic {topic!r} is published by {first!r} already")
            if graph.is_away(name) and not TOPICS[topic].elsewhere:
                raise ConfigError(
                    f"{where}: nodes.{name}.host = {graph.nodes[name].host!r}: topic {topic!r} is published "
                    f"on the robot's own machine alone, {graph.hosts[0]}"
                )
    return resolved


def _import(name: str, place: str) -> ModuleType:
    full = name if "." in name else f"{_HOME}.{name}"
    try:
        module = importlib.import_module(full)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{full}.".startswith(f"{error.name}."):
            raise ConfigError(f"{place} = {name!r}: needs {error.name!r}, which is not installed") from error
        if "." not in name:
            known = [m.name for m in pkgutil.iter_modules(importlib.import_module(_HOME).__path__)]
            configuration.refuse_unknown([name], known, place)
        raise ConfigError(f"{place} = {name!r}: no such module") from error
    except ImportError as error:
        raise ConfigError(f"{place} = {name!r}: cannot be imported: {error}") from error
    if missing := [
        part for part in ("Config", "SUBSCRIBES", "PUBLISHES", "run") if not hasattr(module, part)
    ]:
        raise ConfigError(f"{place} = {name!r}: is no node, it has no {missing[0]}")
    return module


def _placed(value: Any, run_dir: Path) -> Any:
    """Fill the directory of this run into the strings of a configuration."""
    if isinstance(value, str):
        return value.replace(RUN_PLACEHOLDER, str(run_dir))
    if isinstance(value, Mapping):
        return {key: _placed(item, run_dir) for key, item in value.items()}
    return [_placed(item, run_dir) for item in value] if isinstance(value, list) else value


def has_screen() -> bool:
    """Whether a window can be opened here."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_robot(name: str, option: str) -> None:
    """Refuse what a graph would refuse as the name of its robot; raises ConfigError."""
    if not _NAME.match(name):
        raise ConfigError(f"{option} = {name!r}, must be lower-case letters, digits and underscores")


def main(argv: list[str] | None = None) -> int:
    """Check a graph in full and print it resolved, as JSON: `python -m runtime.graph FILE [--headless]`."""
    import argparse
    import json
    import sys

    parser = argparse.ArgumentParser(prog="runtime.graph", description=main.__doc__, allow_abbrev=False)
    parser.add_argument("file", type=Path)
    parser.add_argument("--headless", action="store_true", help="leave out what needs a screen")
    parser.add_argument("--elsewhere", nargs="*", default=[], help="processes that run on other machines")
    args = parser.parse_args(argv)
    try:
        graph = load(args.file)
        graph = graph.without_screen() if args.headless else graph
        resolved = resolve_all(graph, str(args.file), args.elsewhere)
    except ConfigError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    nodes = {
        name: {
            "config": configuration.plain(node.config),
            "subscribes": node.subscribes,
            "publishes": node.publishes,
        }
        for name, node in resolved.items()
    }
    sys.stdout.write(json.dumps(nodes) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
