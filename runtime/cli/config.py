"""Print the configuration of a graph, defaults too; or check it.

Nothing is started.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from runtime.graph import Graph, Resolved
    from runtime.parameters import Parameter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for name, text in (
        (
            "dump",
            "print the graph with every default filled in, as YAML: unit, limits, and whose each value is",
        ),
        ("check", "say whether the graph may start; 2 if not"),
    ):
        action = actions.add_parser(name, help=text, description=text)
        action.add_argument(
            "graph", nargs="?", default="demo", help="demo, handheld, onboard, or a YAML file (default demo)"
        )


def run(args: argparse.Namespace) -> int:
    """Dump or check."""
    from runtime import graph as graphs
    from runtime.cli.compiling import uncompiled

    file = graphs.find(args.graph)
    graph = graphs.load(file)
    with uncompiled():
        resolved = graphs.resolve_all(graph, str(file))
    if args.action == "check":
        where = f" on {', '.join(graph.hosts)}" if graph.hosts else ""
        print(f"{file}: {len(graph.nodes)} processes{where}, good")
        return 0
    print(_dumped(file, graph, resolved), end="")
    return 0


def _dumped(file: Path, graph: "Graph", resolved: "dict[str, Resolved]") -> str:
    """Return the graph as YAML that is that graph again, with a comment behind each value."""
    from runtime import config
    from runtime.parameters import parameters

    plain = config.plain(graph)
    written = config.load_yaml(file)
    kinds: dict[str, type] = {"": type(graph)}
    for name, node in resolved.items():
        plain["nodes"][name]["config"] = config.plain(node.config)
        kinds |= {f"nodes.{name}.": type(graph.nodes[name]), f"nodes.{name}.config.": type(node.config)}
    notes = {
        place + one.name: _note(one, _holds(written, (place + one.name).split(".")))
        for place, kind in kinds.items()
        for one in parameters(kind)
    }
    nodes = plain.pop("nodes")  # last, so that what is said of all of them is not overlooked
    return config.annotated_yaml({**plain, "nodes": nodes}, notes)


def _holds(written: Any, keys: list[str]) -> bool:
    """Whether a file says what stands at this place."""
    for key in keys:
        if not isinstance(written, dict) or key not in written:
            return False
        written = written[key]
    return True


def _note(one: "Parameter", from_file: bool) -> str:
    """Return unit, limits, and where the value comes from."""
    from dataclasses import MISSING

    from runtime import config

    origin = "default"
    if from_file:
        default = config.in_yaml(config.plain(one.default)) if one.default is not MISSING else ""
        origin = f"from the file; default {default}" if default else "from the file"
    return "; ".join(part for part in (one.unit, one.limits, origin) if part)
