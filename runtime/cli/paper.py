"""Make our counterpart of the paper's figures and tables from simulated buildings with a known truth."""

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.errors import ConfigError

if TYPE_CHECKING:
    from runtime.cli.study.drives import Drive

_COLUMNS = (
    ("match_mm", "each match, mm", "{:.1f}"),
    ("match_deg", "each match, deg", "{:.2f}"),
    ("stretch_mm", "over 1 m, mm", "{:.0f}"),
    ("ate_m", "whole way, m", "{:.3f}"),
    ("max_m", "greatest, m", "{:.3f}"),
    ("lost", "lost", "{:.0f}"),
    ("degenerate", "one direction unseen", "{:.0f}"),
    ("ms", "ms a scan", "{:.1f}"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("--out", type=Path, default=Path("paper"), metavar="DIR", help="default paper")
    parser.add_argument("--scans", type=int, default=1200, metavar="N", help="of each drive at most")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of noise and search (default 1)")
    parser.add_argument("--buildings", nargs="+", metavar="B", help="which of them (default all seven)")
    parser.add_argument("--json", action="store_true", help="machine-readable, one object at the end")


def run(args: argparse.Namespace) -> int:
    """Write figures, `tables.md` and `numbers.json`; takes some minutes."""
    from runtime.cli.study.drives import BUILDINGS, drive
    from runtime.config import refuse_unknown

    if not 20 <= args.scans <= 100_000:
        raise ConfigError(f"--scans = {args.scans}, must be in [20, 100000]")
    names = args.buildings or list(BUILDINGS)
    refuse_unknown(names, list(BUILDINGS), "--buildings")
    args.out.mkdir(parents=True, exist_ok=True)
    numbers: dict[str, dict[str, dict[str, float]]] = {}
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        driven = drive(name, args.scans, args.seed)
        numbers[name] = _study(driven, args.out, args.seed)
    tables = _tables(numbers)
    (args.out / "tables.md").write_text(tables, encoding="utf-8")
    (args.out / "numbers.json").write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
    print(json.dumps({"out": str(args.out), **numbers}) if args.json else tables, end="\n")
    return 0


def _study(driven: "Drive", out: Path, seed: int) -> dict[str, dict[str, float]]:
    """Follow one drive in every variant; draw the figures of the first two."""
    from processing.slam import SlamConfig
    from runtime.cli.study import drives, figures, stages
    from runtime.picture import png

    numbers = {}
    name = driven.name.replace(" ", "-")
    for variant, config in stages.variants().items():
        if isinstance(config, SlamConfig):
            followed = drives.map_it(driven, config, seed)
            (out / f"fig8-map-{name}.png").write_bytes(png(figures.map_of(driven, followed)))
        else:
            followed = drives.follow(driven, config, seed)
        if variant == stages.MATCHER:
            (out / f"fig6-way-{name}.png").write_bytes(png(figures.way(driven, followed)))
        numbers[variant] = drives.errors(driven, followed)
    middle = len(driven.scans) // 2
    (out / f"fig2-resampling-{name}.png").write_bytes(png(figures.resampling(driven, middle)))
    (out / f"fig4-evolution-{name}.png").write_bytes(png(figures.evolution(driven, middle, seed)))
    return numbers


def _tables(numbers: dict[str, dict[str, dict[str, float]]]) -> str:
    from runtime.cli.study import stages

    variants = list(stages.variants())
    # In a bare corridor nobody can know how far the laser went: its error would drown every difference.
    seen = [rows for rows in numbers.values() if not rows[stages.WHOLE]["degenerate"]]
    means = {
        variant: _mean([rows[variant] for rows in seen or list(numbers.values())]) for variant in variants
    }
    parts = [
        "# The method in numbers\n",
        "Errors against the truth of simulated drives with the noise of a URG-04LX; rms where nothing else is"
        " said. Made by `hallway paper`.\n",
        "## Each building\n",
        _table({name: rows[stages.WHOLE] for name, rows in numbers.items()}, "building"),
        "## What each stage is worth\n",
        "Means over the buildings in which every direction is seen; lost and unseen are sums. In a bare"
        " corridor no laser knows how far it went; what counts is that it says so: see the table above.\n",
        _table(means, "pipeline"),
    ]
    return "\n".join(parts)


def _mean(rows: list[dict[str, float]]) -> dict[str, float]:
    import numpy as np

    sums = ("lost", "degenerate")
    return {key: float((np.sum if key in sums else np.mean)([row[key] for row in rows])) for key in rows[0]}


def _table(rows: dict[str, dict[str, Any]], first: str) -> str:
    head = (
        f"| {first} | "
        + " | ".join(title for _, title, _ in _COLUMNS)
        + " |\n|"
        + "---|" * (len(_COLUMNS) + 1)
    )
    lines = [
        f"| {name} | " + " | ".join(form.format(row[key]) for key, _, form in _COLUMNS) + " |"
        for name, row in rows.items()
    ]
    return "\n".join([head, *lines]) + "\n"
