"""The hub: introduces the processes of a robot to each other, and visitors to all of them.

`python -m runtime.supervision.hub --run-dir DIR`. It carries nothing between local processes once they know
each other, so that it may die and come back without a gap; and so it begins anew when the list of guests
changes.
"""

import argparse
import logging
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from runtime.access import gate, keys
from runtime.bus import links
from runtime.errors import HallwayError
from runtime.process import realtime
from runtime.process.log_lines import log_to_stderr

_SLICE_S = 0.2


def main(argv: Sequence[str] | None = None) -> int:
    """Stand there until asked to stop."""
    realtime.follow_parent()
    parser = argparse.ArgumentParser(prog="runtime.supervision.hub", description=__doc__)
    parser.add_argument("--run-dir", type=Path, required=True)
    parser.add_argument("--remote", metavar="ADDRESS:PORT", help="also listen here, for guests with keys")
    parser.add_argument("--lead", action="store_true", help="lead on to the robot, paired with this machine")
    parser.add_argument("--robot", default="robot")
    parser.add_argument("--domain", type=int, default=0)
    args = parser.parse_args(argv)
    log_to_stderr()
    log = logging.getLogger("hub")
    asked_to_stop: list[
        int
    ] = []  # not an Event: a second signal in the middle of setting it would wait for ever
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _: asked_to_stop.append(number))
    from runtime.bus.zenoh_bus import ZenohBus

    try:
        host = keys.authority(args.robot) if args.remote else None
        while not asked_to_stop:
            door, listed = None, host.roster() if host else {}
            if host is not None:
                door = gate.door(host, args.robot, args.domain, args.remote, listed)
            elif args.lead and (invitation := keys.paired(args.robot)) is not None:
                door = gate.lead(invitation)
            with ZenohBus(links.hub(args.run_dir, door)):
                # In slices: a signal that another thread takes does not end a wait without end.
                while not asked_to_stop and (host is None or not _has_changed(host, listed)):
                    time.sleep(_SLICE_S)
            if not asked_to_stop:
                log.info("the list of guests has changed: all are asked for their names again")
    except HallwayError as error:
        log.error("%s", error)
        return error.exit_code
    return 0


def _has_changed(host: keys.Authority, listed: Mapping[str, keys.Role]) -> bool:
    """Whether the list of guests is another one; one that cannot be read changes nothing."""
    try:
        return host.roster() != listed
    except (HallwayError, OSError):
        return False


if __name__ == "__main__":
    sys.exit(main())
