"""Write the reference pages from the code: `python docs/make_reference.py` writes, `--check` only compares.

What a parameter means, its default and its limits are read where they are written: in the dataclasses.
"""

import dataclasses
import inspect
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent

_CONFIG_HEAD = """\
# Configuration reference

Nobody has to set anything to get a map. This page lists everything that can be set, in the words of the code
(`python docs/make_reference.py` makes it; a test checks that it is current).

A graph is a YAML file: the robot's name, a seed, and its processes. Whatever is not in the file keeps its
default; an unknown key is an error that names the nearest known one. `hallway config dump` prints a graph
with every default filled in, and beside each value its unit, its limits, and whether it is the file's or the
default; `hallway config check FILE` says whether it may start.

Those that people need, if any:

| parameter | when |
|---|---|
| `laser.path`, `base.path` | the devices are not at the default ports |
| `laser_in_base`, see [the offline map](#hallway-map) | poses of the robot's middle are wanted |
| `matcher.laser_in_base` | Nav2, or whoever else asks for `base_link`, shall find it in `tf` |
| `matcher.odometry.prediction.acceleration`, `.turning` | the laser is thrown about by hand |
| `mapper.mapping.particles` | the machine is slow, or the building is large and full of loops |
| `hosts`, `host` of a process | it shall run on another machine: see the [tutorial](tutorial.md), 7 |
| `viewer.mode`, `viewer.memory_mb` | the picture shall be a page, or use less memory |
| `recorder.file`, `recorder.topics` | recordings shall go elsewhere, or hold less |
"""

_OFFLINE = """\
<a id="hallway-map"></a>

## `hallway map --config`

`slam.odometry` takes the keys of `odometry` of the [matcher](#matcher), `slam.mapping` those of `mapping` of
the [mapper](#mapper).

"""

_TOPICS_HEAD = """\
| topic | type | rate, Hz | a subscriber keeps | latched | recorded |
|---|---|---|---|---|---|
"""


def configuration() -> str:
    """Return the page of all parameters."""
    from runtime import graph
    from runtime.graph import Graph, NodeSpec
    from runtime.nodes.offline_config import OfflineConfig

    parts = [_CONFIG_HEAD, "## The graph\n", _table(_rows(Graph))]
    parts += ["## One process of a graph\n", _table(_rows(NodeSpec))]
    seen: set[str] = set()
    for name in graph.ours():
        file = graph.find(name)
        for resolved in graph.resolve_all(graph.load(file), name).values():
            if (module := resolved.module.__name__.rpartition(".")[2]) in seen:
                continue
            seen.add(module)
            first = (inspect.getdoc(resolved.module) or "").splitlines()[0]
            table = _table(_rows(type(resolved.config))) or "Nothing to set.\n"
            parts += [f"## `{module}`\n", f"{first}\n", table]
    rows = [row for row in _rows(OfflineConfig) if not row.startswith("| `slam.")]
    parts += [_OFFLINE, _table(rows)]
    return "\n".join(parts)


def topics() -> str:
    """Return the table of all topics."""
    from runtime.topics import ALL, TOPICS

    rows = []
    for topic in TOPICS.values():
        keep = {1: "the newest", ALL: "all"}.get(topic.keep, f"the newest {topic.keep}")
        rate = f"{topic.rate_hz:g}" if topic.rate_hz else "when it changes"
        marks = ["yes" if flag else "no" for flag in (topic.latched, topic.recorded)]
        rows.append(f"| `{topic.name}` | `{topic.type}` | {rate} | {keep} | {marks[0]} | {marks[1]} |")
    return _TOPICS_HEAD + "\n".join(rows) + "\n"


def _table(rows: list[str]) -> str:
    head = "| parameter | default | unit | limits | meaning |\n|---|---|---|---|---|\n"
    return head + "\n".join(rows) + "\n" if rows else ""


def _rows(cls: type) -> list[str]:
    from runtime.parameters import parameters

    rows = []
    for one in parameters(cls):
        cells = (f"`{one.name}`", f"`{_default(one.default)}`", one.unit, one.limits, one.meaning)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return rows


def _default(value: Any) -> str:
    if value is dataclasses.MISSING:
        return "required"
    if isinstance(value, float) and value >= 1e5:
        return f"{value:g}"
    if isinstance(value, Path):
        return str(value)
    return repr(getattr(value, "value", value))


PAGES = {"configuration.md": configuration}
BLOCKS = {"wire-format.md": ("topics", topics)}


def current() -> dict[str, str]:
    """Return what each page that has made parts should be."""
    pages = {name: make() for name, make in PAGES.items()}
    for name, (mark, make) in BLOCKS.items():
        before, rest = (DOCS / name).read_text().split(f"<!-- {mark}: made -->\n")
        after = rest.split(f"<!-- end of {mark} -->")[1]
        pages[name] = f"{before}<!-- {mark}: made -->\n{make()}<!-- end of {mark} -->{after}"
    return pages


def main() -> int:
    """Write the pages, or compare them; 1 if one is not current."""
    code = 0
    for name, text in current().items():
        page = DOCS / name
        if page.is_file() and page.read_text() == text:
            continue
        if "--check" in sys.argv[1:]:
            sys.stdout.write(f"docs/{name} is not current: python docs/make_reference.py\n")
            code = 1
        else:
            page.write_text(text)
    return code


if __name__ == "__main__":
    sys.path.insert(0, str(DOCS.parent))
    sys.exit(main())
