"""Compare a trajectory with the truth.

The truth is relations as those of Kümmerle et al., or another trajectory.
"""

import argparse
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.cli.for_machines import print_json
from runtime.cli.parsing import number
from runtime.errors import ConfigError, DataLostError

if TYPE_CHECKING:
    from processing.evaluation import PoseErrors
    from runtime.formats.tum import Trajectory

STAMP_TOLERANCE_NS = 1000
"""Relations name scans by their raw stamps; a microsecond is how exactly both are printed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("trajectory", type=Path, help="TUM file, or a results folder")
    truth = parser.add_mutually_exclusive_group(required=True)
    truth.add_argument("--relations", type=Path, metavar="F", help="relative poses between raw stamps")
    truth.add_argument(
        "--reference", type=Path, metavar="F", help="true trajectory, TUM file or results folder: ATE and RPE"
    )
    parser.add_argument(
        "--laser-in-base", type=number(), nargs=3, metavar=("X", "Y", "YAW"),
        help="mounting (m, m, rad): the trajectory is the laser's, the truth the base's",
    )  # fmt: skip
    parser.add_argument(
        "--max-difference", type=float, default=0.02, metavar="S",
        help="seconds between stamps that still count as one moment, for --reference (default 0.02)",
    )  # fmt: skip
    parser.add_argument(
        "--stretch", type=float, default=1.0, metavar="M",
        help="metres of way over which RPE is measured (default 1)",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="machine-readable, one object")


def run(args: argparse.Namespace) -> int:
    """Print the errors; 0 when every truth was compared, 4 when poses lack for some, or a file is cut."""
    import numpy as np

    from processing.se2 import compose, invert
    from runtime.formats.tum import read_tum

    if not 0 < args.stretch < math.inf:
        raise ConfigError(f"--stretch = {args.stretch}, must be positive and finite")
    if not args.max_difference >= 0:
        raise ConfigError(f"--max-difference = {args.max_difference}, must be at least 0")
    trajectory = read_tum(_tum_file(args.trajectory))
    if args.laser_in_base:
        mounted = compose(trajectory.poses, invert(np.array(args.laser_in_base)))
        trajectory = replace(trajectory, poses=mounted)
    report = _relations(args, trajectory) if args.relations else _reference(args, trajectory)
    if args.json:
        print_json(report)
    else:
        _print_table(report)
    if "ate" in report and "rpe" not in report:
        print(
            f"hallway evaluate: no RPE: the way is shorter than --stretch {args.stretch:g} m", file=sys.stderr
        )
    for one in report["losses"]:
        print(f"hallway evaluate: {one}", file=sys.stderr)
    if report["compared"] < report["truths"]:
        missing = report["truths"] - report["compared"]
        print(
            f"hallway evaluate: {missing} of {report['truths']} truths have no pose at their stamps;"
            " the errors speak of the others only",
            file=sys.stderr,
        )
        return int(DataLostError.exit_code)
    return int(DataLostError.exit_code) if report["losses"] else 0


def _tum_file(path: Path) -> Path:
    """Return the trajectory that a person means: the file, or the one in a results folder."""
    return path / "trajectory.tum" if path.is_dir() else path


def _relations(args: argparse.Namespace, trajectory: "Trajectory") -> dict[str, Any]:
    from processing.evaluation import nearest_stamps, relation_errors
    from runtime.formats.relations import read_relations

    relations = read_relations(args.relations)
    a = nearest_stamps(trajectory.stamps_ns, relations.stamps_a_ns, STAMP_TOLERANCE_NS)
    b = nearest_stamps(trajectory.stamps_ns, relations.stamps_b_ns, STAMP_TOLERANCE_NS)
    both = (a >= 0) & (b >= 0)
    if not both.any():
        raise ConfigError(
            f"{args.relations}: none of its {len(relations)} pairs of stamps is in {args.trajectory}"
        )
    poses = trajectory.poses
    errors = relation_errors(poses[a[both]], poses[b[both]], relations.a_t_b[both])
    return _report(args, "relations", len(relations), {"relation": errors}, trajectory.losses)


def _reference(args: argparse.Namespace, trajectory: "Trajectory") -> dict[str, Any]:
    from processing.evaluation import absolute_errors, nearest_stamps, relative_errors
    from runtime.formats.tum import read_tum

    reference = read_tum(_tum_file(args.reference))
    tolerance_ns = round(args.max_difference * 1e9)
    index = nearest_stamps(trajectory.stamps_ns, reference.stamps_ns, tolerance_ns)
    found = index >= 0
    if found.sum() < 2:
        rule = f"{found.sum()} of its {len(reference)} stamps are in {args.trajectory}, must be at least 2"
        raise ConfigError(f"{args.reference}: {rule}")
    truth, estimate = reference.poses[found], trajectory.poses[index[found]]
    stretches = relative_errors(truth, estimate, args.stretch)
    errors = {"ate": absolute_errors(truth, estimate)}
    if len(stretches):
        errors["rpe"] = stretches
    return _report(args, "reference", len(reference), errors, trajectory.losses + reference.losses)


def _report(
    args: argparse.Namespace,
    kind: str,
    truths: int,
    errors: "dict[str, PoseErrors]",
    losses: tuple[str, ...],
) -> dict[str, Any]:
    from dataclasses import asdict

    from processing.evaluation import summarise

    report: dict[str, Any] = {"trajectory": str(args.trajectory), kind: str(getattr(args, kind))}
    report |= {"truths": truths, "compared": len(next(iter(errors.values())))}
    if "rpe" in errors:
        report["stretch_m"] = args.stretch
    for name, of in errors.items():
        report[name] = {
            "count": len(of),
            "translation_m": asdict(summarise(of.translation_m)),
            "rotation_deg": asdict(summarise(of.rotation_deg)),
        }
    report["losses"] = list(losses)
    return report


def _print_table(report: dict[str, Any]) -> None:
    titles = {"relation": "relations", "ate": "ATE, aligned", "rpe": f"RPE over {report.get('stretch_m')} m"}
    print(f"{report['compared']} of {report['truths']} truths compared")
    print(f"{'':<16}{'':<4}{'mean ± std':>18}{'rmse':>9}{'median':>9}{'p95':>9}{'max':>9}")
    for name, title in titles.items():
        if name not in report:
            continue
        for unit, key, digits in (("m", "translation_m", 4), ("deg", "rotation_deg", 3)):
            s = report[name][key]
            spread = f"{s['mean']:.{digits}f} ± {s['std']:.{digits}f}"
            rest = "".join(f"{s[column]:>9.{digits}f}" for column in ("rmse", "median", "p95", "max"))
            print(f"{title:<16}{unit:<4}{spread:>18}{rest}")
            title = ""
