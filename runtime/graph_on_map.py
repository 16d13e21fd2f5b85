"""A graph whose mapper begins on a saved map, made of one that begins anew."""

from pathlib import Path

import yaml

from runtime import graph as graphs
from runtime.errors import ConfigError

MAPPER = "mapper"
"""Module of the node that holds the map."""


def on_map(file: Path, session: Path, extend: bool, folder: Path) -> Path:
    """Write the graph of `file` with a saved map for its mapper; return where.

    Args:
        file: A graph.
        session: Session file, or a results folder that holds one, checked.
        extend: Whether the drive is mapped onto the saved map; else that stays as it is.
        folder: Takes a file of the same name.

    Raises:
        ConfigError: There is no mapper in the graph.
    """
    mappers = [name for name, node in graphs.load(file).nodes.items() if node.module == MAPPER]
    if not mappers:
        raise ConfigError(f"--on {session}: {file.name} has no mapper")
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    for name in mappers:
        node = content["nodes"][name]
        node["config"] = {**(node.get("config") or {}), "session": str(session.absolute()), "extend": extend}
    derived = folder / file.name
    derived.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return derived
