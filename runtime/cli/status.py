"""Show a running robot: processes, rates, latency hop by hop."""

import argparse
import sys
import time

from runtime.cli.for_machines import print_json
from runtime.cli.which_robot import add_robot

_LISTEN_S = 1.6
"""Every process speaks once a second; one look waits a little longer than that."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    add_robot(parser, domain=True)
    parser.add_argument("--once", action="store_true", help="look once and end; 1 if something is wrong")
    parser.add_argument("--json", action="store_true", help="machine-readable, one object a line")


def run(args: argparse.Namespace) -> int:
    """Show the status until Ctrl-C; with --once 0 if every process is well, else 1."""
    from runtime import rundir
    from runtime.access import gate
    from runtime.bus.offset import AGAIN_S, measured
    from runtime.bus.zenoh_bus import ZenohBus
    from runtime.cli.screen import Screen
    from runtime.clock import Clock
    from runtime.process.health import Health
    from runtime.process.status import status_of

    with ZenohBus(gate.visit(args.robot)) as bus:
        health = Health(bus, args.robot, args.domain)
        began = time.monotonic()
        if args.once:
            time.sleep(_LISTEN_S)
            status = status_of(args.robot, health.vitals(), measured(bus, args.robot, Clock()))
            if args.json:
                print_json(status.to_json())
            else:
                _print(status)
            well = all(line.level == "ok" for line in status.processes)
            return 0 if well and status.processes else 1
        with Screen(quiet=args.json) as screen:
            presence = rundir.Presence(args.robot)
            offset, ask_s = None, began
            while not presence.gone and not screen.unread:
                if time.monotonic() >= ask_s:
                    offset = measured(bus, args.robot, Clock())
                    ask_s = time.monotonic() + (AGAIN_S if offset else _LISTEN_S)
                status = status_of(args.robot, health.vitals(), offset)
                screen.show(status, time.monotonic() - began)
                if args.json:
                    print_json(status.to_json())
                time.sleep(1.0 if args.json else 0.25)
        screen.check_read()
        print(f"robot {args.robot!r} has ended", file=sys.stderr)
        return 0


def _print(status: object) -> None:
    from rich.console import Console

    from runtime.cli.screen import table
    from runtime.process.status import Status

    assert isinstance(status, Status)
    Console(highlight=False).print(table(status, None))
