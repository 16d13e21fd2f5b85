"""Make our counterpart of the paper's figures and tables.

From simulated buildings, and from logs where some are given.
"""

import argparse
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.cli.for_machines import print_json
from runtime.errors import ConfigError, DataLostError

if TYPE_CHECKING:
    from runtime.cli.study.work import Numbers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("--out", type=Path, default=Path("paper"), metavar="DIR", help="default paper")
    parser.add_argument(
        "--scans",
        type=int,
        default=1200,
        metavar="N",
        help="of each drive at most (default 1200: under five minutes on two cores)",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of noise and search (default 1)")
    parser.add_argument("--buildings", nargs="*", metavar="B", help="which of them (default all seven)")
    parser.add_argument(
        "--logs", nargs="+", type=Path, default=[], metavar="LOG", help="real logs to follow as well"
    )
    parser.add_argument("--json", action="store_true", help="machine-readable, one object at the end")


def run(args: argparse.Namespace) -> int:
    """Write figures, `index.html`, `tables.md` and `numbers.json`; 4 where a log had lost something.

    The cores share the drives out.
    """
    from runtime.cli.compiling import compile_here
    from runtime.cli.map import check_seed
    from runtime.formats.logs import open_log
    from runtime.reports.results import check_writable, to_json

    if not 20 <= args.scans <= 100_000:
        raise ConfigError(f"--scans = {args.scans}, must be in [20, 100000]")
    check_seed(args.seed)
    if args.out.is_file():
        raise ConfigError(f"{args.out}: is a file, must be a folder or not exist")
    check_writable(args.out)
    lost = False
    for log in map(open_log, args.logs):  # what is wrong with one is said before the work begins
        lost |= bool(log.losses)
        for notice in log.notices + log.losses:
            print(f"hallway paper: {notice}", file=sys.stderr)
    compile_here("paper")
    from runtime.cli.study import document, tables
    from runtime.cli.study.drives import BUILDINGS
    from runtime.config import refuse_unknown

    names = list(BUILDINGS) if args.buildings is None else args.buildings
    refuse_unknown(names, list(BUILDINGS), "--buildings", what="building")
    args.out.mkdir(parents=True, exist_ok=True)
    found: dict[str, Numbers] = {}
    hurried: dict[str, Numbers] = {}
    for name, numbers, hasty in _studied([*names, *args.logs], args):
        print(f"{name}: done", file=sys.stderr, flush=True)
        found[name] = numbers
        if hasty:
            hurried[name] = hasty
    buildings = {name: found[name] for name in names}
    hurried = {name: hurried[name] for name in names}
    logs = {name: numbers for name, numbers in found.items() if name not in buildings}
    told = tables.page(buildings, hurried, logs)
    page = [*told, *tables.figures([*buildings, *logs])]
    (args.out / "tables.md").write_text(document.markdown(page), encoding="utf-8")
    (args.out / "index.html").write_text(document.web_page(page), encoding="utf-8")
    report = {"buildings": buildings, "hurried": hurried, "logs": logs}
    (args.out / "numbers.json").write_text(to_json(report), encoding="utf-8")
    if args.json:
        print_json({"out": str(args.out), **report})
    else:
        print(f"{document.markdown(told)}\n{args.out}/index.html: this with the figures")
    return int(DataLostError.exit_code) if lost else 0


def _studied(wheres: list[Any], args: argparse.Namespace) -> "Iterator[tuple[str, Numbers, Numbers]]":
    """Study each drive, as many at once as there are cores; yield them as they are done."""
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    from runtime.cli.study.work import study

    workers = min(len(os.sched_getaffinity(0)), len(wheres))
    if workers < 2:
        for where in wheres:
            yield study(where, args.scans, args.out, args.seed)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        tasks = [pool.submit(study, where, args.scans, args.out, args.seed) for where in wheres]
        for task in as_completed(tasks):
            yield task.result()
