"""Print the configuration of a graph with all its defaults, or check a graph without starting it."""

import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for name, text in (
        ("dump", "print the graph with every default filled in, as YAML"),
        ("check", "say whether the graph may start; 2 if not"),
    ):
        action = actions.add_parser(name, help=text, description=text)
        action.add_argument(
            "graph", nargs="?", default="demo", help="demo, handheld, onboard, or a YAML file (default demo)"
        )


def run(args: argparse.Namespace) -> int:
    """Dump or check."""
    from runtime import config
    from runtime import graph as graphs

    file = graphs.find(args.graph)
    graph = graphs.load(file)
    resolved = graphs.resolve_all(graph, str(file))
    if args.action == "check":
        print(f"{file}: {len(graph.nodes)} processes, good")
        return 0
    plain = config.plain(graph)
    for name, node in resolved.items():
        plain["nodes"][name]["config"] = config.plain(node.config)
    head = {key: value for key, value in plain.items() if key != "nodes"}
    print(config.to_yaml({**head, "nodes": plain["nodes"]}), end="")
    return 0
