"""Follow the laser of a log on a saved map, from an unknown start.

The map stays as it is.
"""

import argparse
import sys
from pathlib import Path

from runtime.cli.for_machines import print_json
from runtime.cli.map import check_scanner, check_seed, feed
from runtime.cli.progress import Progress
from runtime.cli.stopping import asked_to_stop, insisting
from runtime.cli.whereabouts import Whereabouts
from runtime.errors import DataLostError, PositionLostError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("session", type=Path, help="session file, or a results folder that holds one")
    parser.add_argument("log", type=Path, help="laser log, ROS bag or MCAP, as `hallway map` takes them")
    parser.add_argument("--out", type=Path, metavar="DIR", help="results folder (default: NAME-on-map)")
    parser.add_argument("--seed", type=int, metavar="N", help="of random numbers (default: the session's)")
    parser.add_argument("--topic", metavar="T", help="which LaserScan topic of a bag")
    parser.add_argument("--json", action="store_true", help="machine-readable, one object")


def run(args: argparse.Namespace) -> int:
    """Write the trajectory: 0 done, 4 scans missing, 5 not found or lost at the end, 130 after Ctrl-C."""
    from runtime.cli.compiling import compile_here
    from runtime.cli.gaps import print_gaps
    from runtime.formats.logs import open_log
    from runtime.formats.session import check_session
    from runtime.reports.results import check_free, default_folder, save

    check_seed(args.seed)
    log = open_log(args.log, args.topic)
    check_session(args.session)
    out = args.out or default_folder(args.log).with_name(f"{default_folder(args.log).name}-on-map")
    check_free(out)
    compile_here("localize")
    from runtime.nodes import saved as sessions
    from runtime.nodes.offline import OfflineRun

    saved = sessions.load(args.session)
    check_scanner(log, saved)
    for notice in log.notices + log.losses:
        print(f"hallway localize: {notice}", file=sys.stderr)
    offline = OfflineRun(
        saved.config, saved.session.seed if args.seed is None else args.seed, saved, fixed=True
    )
    with (
        asked_to_stop(insisting(2)) as stopping,
        Progress(len(log), log.geometry.period_s, args.json) as progress,
    ):
        where = Whereabouts(progress.say, log.geometry.period_s)
        feed(offline, log, progress, stopping, where)
    report = {"session": str(saved.session.path), "scans": progress.done, **where.report()}
    report |= {"gaps": list(log.gaps), "losses": list(log.losses)}
    interrupted = progress.done < len(log)
    if offline.found:
        save(out, offline.result(log, {"interrupted": True} if interrupted else None))
        report["out"] = str(out)
    if args.json:
        print_json(report)
    elif offline.found:
        print_gaps("not in the recording", log.gaps)
        print(f"{progress.done} scans; {out}/: trajectory.tum on the saved map, map.png with the way")
    if not offline.found:
        print(
            f"hallway localize: not found on {saved.session.path} within {progress.done} scans; "
            + ("several places fitted equally" if where.refusals else "nothing on it fits")
            + "; nothing was written",
            file=sys.stderr,
        )
        return 130 if interrupted else int(PositionLostError.exit_code)
    if interrupted:
        return 130
    if where.lost or offline.state == "LOST":
        print("hallway localize: the place was lost again before the log ended", file=sys.stderr)
        return int(PositionLostError.exit_code)
    return int(DataLostError.exit_code) if log.losses else 0
