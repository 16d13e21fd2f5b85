"""Print what the processes of a robot, or of a past run, logged."""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

from runtime.cli.parsing import whole_number
from runtime.cli.which_robot import add_robot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("node", nargs="*", help="only these processes")
    add_robot(parser)
    parser.add_argument(
        "--results", type=Path, metavar="DIR", help="of a finished run, such as results/latest"
    )
    parser.add_argument("-f", "--follow", action="store_true", help="go on until Ctrl-C")
    parser.add_argument(
        "-n", "--lines", type=whole_number(0), default=20, help="of each process (default 20; 0: all)"
    )


def run(args: argparse.Namespace) -> int:
    """Print the logs in the order of their time."""
    from runtime import rundir
    from runtime.config import refuse_unknown
    from runtime.errors import ConfigError

    try:
        folder = (args.results or rundir.running(args.robot)) / "logs"
    except rundir.NotRunningError as error:
        finished = "of a finished run: `hallway logs --results results/latest`"
        raise rundir.NotRunningError(f"{error}; {finished}") from error
    files = {path.stem: path for path in sorted(folder.glob("*.log"))}
    if not files:
        raise ConfigError(f"{folder}: holds no logs")
    refuse_unknown(args.node, list(files), str(folder), what="process")
    chosen = {name: files[name] for name in args.node or files}
    lines: list[str] = []
    ends: dict[str, int] = {}
    for name, path in chosen.items():
        text = path.read_text(encoding="utf-8", errors="replace")
        ends[name] = len(text.encode(errors="replace"))
        lines += list(_stamped(text, name))[-args.lines if args.lines else None :]
    for line in sorted(lines, key=lambda one: one.split(" ", 1)[0]):
        print(line)
    while args.follow:
        for name, path in chosen.items():
            for line in _fresh(path, name, ends):
                print(line, flush=True)
        time.sleep(0.2)
    return 0


def _stamped(text: str, name: str) -> Iterator[str]:
    """Yield the lines, each with a time and a name: those of a traceback get the ones of the line before."""
    stamp = ""
    for line in text.splitlines():
        if line[:4].isdigit() and line[4:5] == "-":
            stamp = line.split(" ", 1)[0]
            yield line
        elif line.strip():
            yield f"{stamp} {name}: {line}"


def _fresh(path: Path, name: str, ends: dict[str, int]) -> Iterator[str]:
    """Yield what was written since the last look; a log that was cut is read from its start."""
    try:
        size = path.stat().st_size
    except FileNotFoundError:
        return
    began = ends[name] if size >= ends[name] else 0
    if size > began:
        with path.open("rb") as file:
            file.seek(began)
            fresh = file.read()
        whole = fresh[: fresh.rfind(b"\n") + 1]
        ends[name] = began + len(whole)
        yield from _stamped(whole.decode(errors="replace"), name)
