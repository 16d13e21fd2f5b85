"""One node in its own process: `python -m runtime.process NAME --graph FILE --run-dir DIR`.

The process dies with its parent, stops within a second of a signal, and leaves with the exit code of house
rules; its last line of log says why.
"""

import argparse
import logging
import os
import select
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from runtime import graph, messages
from runtime.bus import links
from runtime.bus.contract import Bus
from runtime.bus.offset import Follower
from runtime.clock import Clock
from runtime.config import refuse_unknown
from runtime.errors import exit_code_of
from runtime.process import realtime
from runtime.process.log_lines import log_to_stderr
from runtime.process.node import BusPort
from runtime.topics import topic


def main(argv: Sequence[str] | None = None) -> int:
    """Run one node of a graph until it ends or is asked to stop."""
    # Whoever is asked to end before it works has nothing to save, and nothing to say: no traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    realtime.follow_parent()
    parser = argparse.ArgumentParser(prog="runtime.process", description=__doc__, allow_abbrev=False)
    parser.add_argument("name", help="of the node in the graph")
    parser.add_argument("--graph", type=Path, required=True)
    parser.add_argument("--run-dir", type=Path, required=True, help="of the robot's sockets")
    parser.add_argument("--results-dir", type=Path, help="where results are written")
    parser.add_argument("--robot", help="instead of the graph's")
    parser.add_argument("--seed", type=int, help="instead of the graph's")
    parser.add_argument(
        "--spare", action="store_true", help="import everything, then wait for a line on stdin"
    )
    args = parser.parse_args(argv)
    log_to_stderr()
    log = logging.getLogger(args.name)
    try:
        return _run(args, log)
    except Exception as error:
        code = exit_code_of(error)
        if code is None:
            log.exception("%s: %s", type(error).__name__, error)
            return 1
        log.error("%s", error)
        return code


def _run(args: argparse.Namespace, log: logging.Logger) -> int:
    loaded = graph.load(args.graph)
    robot = args.robot or loaded.robot
    refuse_unknown([args.name], list(loaded.nodes), f"{args.graph}: nodes")
    spec = loaded.nodes[args.name]
    aside = args.spare and not _is_called() and realtime.step_aside()
    resolved = graph.resolve(args.name, spec, str(args.graph), args.run_dir)
    if args.spare:
        for name in (*resolved.subscribes, *resolved.publishes, "diagnostics"):
            messages.prepare(topic(name).type)
        realtime.settle()
        if not sys.stdin.readline():
            return 0  # nobody needs it any more
    if aside:
        realtime.step_forward(0, like=os.getppid())
    realtime.schedule(log, priority=spec.priority, nice=spec.nice, cores=spec.cores)

    clock, followers = Clock.from_environment(), list[Follower]()

    def open_bus() -> Bus:
        from runtime.bus.zenoh_bus import ZenohBus

        bus = ZenohBus(links.peer(args.run_dir, args.name))
        # Scans have the robot's time. Whoever drives keeps his own: the base takes no stamp that went back,
        # and finds the difference of the clocks itself.
        if loaded.is_away(args.name) and "cmd_vel" not in resolved.publishes:
            followers.append(Follower(bus, robot, clock))
        return bus

    port = BusPort(
        args.name,
        open_bus,
        clock=clock,
        subscribes=resolved.subscribes,
        publishes=resolved.publishes,
        robot=robot,
        domain=loaded.domain,
        seed=loaded.seed if args.seed is None else args.seed,
        run_dir=args.run_dir,
        results_dir=args.results_dir,
        guest=loaded.is_away(args.name),
    )
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: port.stop())
    try:
        with port:
            try:
                return int(resolved.module.run(port, resolved.config))
            except Exception as error:
                port.report("error", str(error) or type(error).__name__)
                raise
    finally:
        for follower in followers:
            follower.close()


def _is_called() -> bool:
    """Whether a spare process is needed before it has imported anything."""
    return bool(select.select([sys.stdin], [], [], 0.0)[0])


if __name__ == "__main__":
    sys.exit(main())
