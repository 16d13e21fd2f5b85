"""Make a map from a laser log, offline, from every scan."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.cli.for_machines import print_json
from runtime.cli.patience import told
from runtime.cli.progress import Progress
from runtime.cli.stopping import asked_to_stop, insisting
from runtime.cli.whereabouts import Whereabouts
from runtime.errors import ConfigError, DataLostError, PositionLostError

if TYPE_CHECKING:
    from runtime.formats.laser_log import LaserLog
    from runtime.nodes.offline import OfflineRun
    from runtime.nodes.offline_config import OfflineConfig
    from runtime.nodes.saved import Saved

MAX_SEED = 2**63
WRITTEN = ("map.png", "report.html", "map.pgm", "map.yaml", "trajectory.tum", "session.mcap")
"""What people look for first; `hallway info` lists the rest."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument(
        "log", type=Path, help="tinySLAM .dat, CARMEN .clf/.log (.gz, .bz2), Wean text, ROS bag or MCAP"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="results folder (default results/NAME)")
    parser.add_argument("--seed", type=int, metavar="N", help="of random numbers (default 0, or as recorded)")
    parser.add_argument("--config", type=Path, metavar="F", help="YAML over the defaults (or as recorded)")
    parser.add_argument("--topic", metavar="T", help="which LaserScan topic of a bag")
    parser.add_argument(
        "--continue",
        dest="onto",
        type=Path,
        metavar="SESSION",
        help="go on with a saved map, on which the drive begins anywhere: a session file or results folder",
    )
    parser.add_argument("--json", action="store_true", help="machine-readable, one object")


def run(args: argparse.Namespace) -> int:
    """Map the log; always with results: 0 done, 4 scans missing, 5 ended lost, 130 after Ctrl-C.

    Also 5 where the drive was not found on the saved map; the results are then a map of its own.
    """
    from runtime.cli.compiling import compile_here
    from runtime.config import load_yaml
    from runtime.formats.logs import open_log
    from runtime.formats.session import check_session
    from runtime.reports.results import check_free, default_folder

    check_seed(args.seed)
    log = open_log(args.log, args.topic)
    out = args.out or default_folder(args.log)
    check_free(out)
    if args.onto is not None:
        check_session(args.onto)
    if args.config is not None:
        load_yaml(args.config)
    compile_here("map")
    from runtime.nodes import saved as sessions
    from runtime.nodes.offline import OfflineRun

    onto = sessions.load(args.onto) if args.onto else None
    if onto is not None:
        check_scanner(log, onto)
    recorded = log.run_seed or 0 if onto is None else onto.session.seed
    seed = recorded if args.seed is None else args.seed
    config = _config(args.config, log, onto)
    for notice in log.notices + log.losses:
        print(f"hallway map: {notice}", file=sys.stderr)
    offline = OfflineRun(config, seed, onto)
    with asked_to_stop(insisting(2)) as stopping:
        with Progress(len(log), log.geometry.period_s, args.json) as progress:
            where = Whereabouts(progress.say, log.geometry.period_s) if onto else None
            feed(offline, log, progress, stopping, where)
        interrupted = progress.done < len(log)
        if progress.done == 0:
            return 130
        with told(progress.say, "saving the map, the way and the report ..."):
            report = {"seed": seed, **_save(offline, log, out, args, interrupted)}
    report |= where.report() if where else {}
    report |= {"seconds": round(progress.elapsed_s, 3), "scans_per_s": round(progress.scans_per_s, 1)}
    report["times_real_time"] = round(progress.times_real_time, 2)
    report |= {"gaps": list(log.gaps), "losses": list(log.losses)}
    _say(report, args.json)
    if interrupted:
        return 130
    if onto is not None and not offline.found:
        why = f"the drive was not found on {onto.session.path}"
        print(f"hallway map: {why}; {out} holds a map of its own", file=sys.stderr)
        return int(PositionLostError.exit_code)
    if offline.state == "LOST":
        print("hallway map: the track was lost and not found again before the log ended", file=sys.stderr)
        return int(PositionLostError.exit_code)
    return int(DataLostError.exit_code) if log.losses else 0


def check_seed(seed: int | None) -> None:
    """Refuse what is no seed: raises ConfigError."""
    if seed is not None and not 0 <= seed < MAX_SEED:
        raise ConfigError(f"--seed = {seed}, must be in [0, 2^63)")


def check_scanner(log: "LaserLog", onto: "Saved") -> None:
    """Refuse a log of another scanner than the saved map's: raises ConfigError."""
    count, must = log.geometry.count, onto.past.scanner.count
    if count != must:
        raise ConfigError(f"{log.path}: scans of {count} beams, must be {must} as in {onto.session.path}")


def _config(path: Path | None, log: "LaserLog", onto: "Saved | None") -> "OfflineConfig":
    from runtime.config import load
    from runtime.nodes.offline_config import OfflineConfig, recorded_config

    if path is not None:
        return load(OfflineConfig, path)
    if onto is not None:
        return onto.config
    return recorded_config(log.run_config, f"{log.path}: config.yaml") if log.run_config else OfflineConfig()


def feed(
    offline: "OfflineRun",
    log: "LaserLog",
    progress: Progress,
    stopping: list[int],
    where: Whereabouts | None = None,
) -> None:
    """Take every scan of a log, until asked to stop."""
    from runtime.nodes.log_scans import counted

    for scan, missed in counted(log):
        if stopping:
            return
        step = offline.step(scan, missed)
        if where is not None:
            where.take(step)
        progress.advance(offline.state)


def _save(
    offline: "OfflineRun", log: "LaserLog", out: Path, args: argparse.Namespace, interrupted: bool
) -> dict[str, Any]:
    from runtime.reports.results import link_latest, save

    result = offline.result(log, {"interrupted": interrupted} if interrupted else None)
    save(out, result)
    if args.out is None:
        link_latest(out)
    return {"out": str(out), **result.metrics}


def _say(report: dict[str, Any], as_json: bool) -> None:
    from runtime.cli.fitting import print_written
    from runtime.cli.gaps import print_gaps

    if as_json:
        print_json(report)
        return
    states = ", ".join(f"{count} {name}" for name, count in report["states"].items())
    print(
        f"{report['scans']} scans in {report['seconds']:.1f} s ({report['times_real_time']:.1f} x real time),"
        f" {report['way_m']:.1f} m driven, {report['known_m2']:.0f} m2 mapped"
    )
    print(f"state of the track, in scans: {states}")
    print_gaps("not in the recording", report["gaps"])
    print_written(report["out"], WRITTEN)
