"""The tables of the study, as Markdown: settings, each building, what each stage is worth, logs, figures."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from processing.evolution import TABLE_1
from processing.odometry import OdometryConfig
from runtime.cli.study import stages
from runtime.cli.study.work import HURRY, Numbers

Columns = Sequence[tuple[str, str, str]]
_FOLLOWED: Columns = (
    ("match_mm", "each match, mm", "{:.1f}"),
    ("ahead_mm", "along, mm", "{:.1f}"),
    ("aside_mm", "across, mm", "{:.1f}"),
    ("match_deg", "turn, deg", "{:.2f}"),
    ("stretch_mm", "over 1 m, mm", "{:.0f}"),
    ("ate_m", "whole way, m", "{:.3f}"),
    ("max_m", "greatest, m", "{:.3f}"),
    ("lost", "lost", "{:.0f}"),
    ("degenerate", "one direction unseen", "{:.0f}"),
    ("ms", "ms a scan", "{:.1f}"),
)
_LOGGED: Columns = (
    ("scans", "scans", "{:.0f}"),
    ("entropy", "entropy of the map, nat", "{:.3f}"),
    ("conflict", "rays through walls, %", "{:.2%}"),
    ("lost", "lost", "{:.0f}"),
    ("degenerate", "one direction unseen", "{:.0f}"),
    ("ms", "ms a scan", "{:.1f}"),
)
_FIGURES = (
    ("fig2-resampling", "2. A sweep, and what resampling keeps of it"),
    ("fig4-evolution", "4. The members of the search, generation by generation"),
    ("fig5-matching", "5. A sweep before and after its match (black: the reference), and how the score rose"),
    ("fig6-way", "6. The way by the matcher alone, red, over all hits, blue; the truth grey"),
    ("fig7-way", "7. The same with the mapper"),
    ("fig8-map", "8. The map"),
    ("fig9-particles", "9. The ways of the particles, thirty times as far apart as they are"),
)


def page(
    buildings: Mapping[str, Numbers], hurried: Mapping[str, Numbers], logs: Mapping[str, Numbers]
) -> str:
    """Return everything.

    Args:
        buildings: Errors by building and variant.
        hurried: The same of the hurried drives.
        logs: Figures by log and variant.
    """
    parts = ["# The method in numbers\n", "Made by `hallway paper`; rms where nothing else is said.\n"]
    parts += ["## Settings (the paper's Table 1)\n", _settings()]
    if buildings:
        rows = {name: numbers[stages.WHOLE] for name, numbers in buildings.items()}
        alone = {name: numbers[stages.MATCHER] for name, numbers in buildings.items()}
        parts += [
            "## Each building\n",
            "Errors against the truth of drives with the noise of a URG-04LX, by the whole pipeline.\n",
            _table(rows, "building", _FOLLOWED),
            "By the matcher alone:\n",
            _table(alone, "building", _FOLLOWED),
            "## What each stage is worth\n",
            "Means over the buildings in which every direction is seen; lost and unseen are sums. In a bare"
            " corridor no laser knows how far it went; what counts is that it says so: see above.\n",
            _table(_means(buildings), "pipeline", _FOLLOWED),
            f"The same drives {HURRY} times as fast: only every {HURRY}th sweep is seen.\n",
            _table(_means(hurried), "pipeline", _FOLLOWED),
        ]
    for name, numbers in logs.items():
        parts += [
            f"## {name}\n",
            "Nobody knows the truth; low entropy and few rays through walls are a crisp map.\n",
            _table({variant: numbers[variant] for variant in stages.of_a_log()}, "pipeline", _LOGGED),
        ]
    return "\n".join([*parts, "## Figures\n", _figures([*buildings, *logs])])


def _settings() -> str:
    ours = OdometryConfig()
    search, ndt = ours.matching.search, ours.ndt
    fine = f" and {ndt.fine_cell_m:g}" if ndt.fine_cell_m else ""
    rows = (
        ("NDT cell, m", "0.5", f"{ndt.cell_m:g}{fine}"),
        ("members, NP", TABLE_1.population, search.population),
        ("generations, G", TABLE_1.generations, f"{search.generations} at most"),
        ("factor, F", f"{TABLE_1.factor:g}", f"{search.factor:g}"),
        ("crossover, CR", f"{TABLE_1.crossover:g}", f"{search.crossover:g}"),
        (
            "ends",
            "at a score found by trial, or at G",
            "when all members meet, or at G; then Newton's method",
        ),
        ("reference", "previous scan", f"the last {ours.key_scans} key scans"),
    )
    lines = [f"| {name} | {paper} | {hallway} |" for name, paper, hallway in rows]
    return "\n".join(["| | paper | Hallway |\n|---|---|---|", *lines]) + "\n"


def _means(numbers: Mapping[str, Numbers]) -> Numbers:
    # In a bare corridor nobody can know how far the laser went: its error would drown every difference.
    seen = [rows for rows in numbers.values() if not rows[stages.MATCHER]["degenerate"]]
    return {
        variant: _mean([rows[variant] for rows in seen or numbers.values()]) for variant in stages.variants()
    }


def _mean(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    sums = ("lost", "degenerate")
    return {key: float((np.sum if key in sums else np.mean)([row[key] for row in rows])) for key in rows[0]}


def _table(rows: Mapping[str, Mapping[str, Any]], first: str, columns: Columns) -> str:
    titles = " | ".join(title for _, title, _ in columns)
    head = f"| {first} | {titles} |\n|" + "---|" * (len(columns) + 1)
    lines = [
        f"| {name} | " + " | ".join(form.format(row[key]) for key, _, form in columns) + " |"
        for name, row in rows.items()
    ]
    return "\n".join([head, *lines]) + "\n"


def _figures(names: Sequence[str]) -> str:
    parts = []
    for file, title in _FIGURES:
        pictures = [f"![{name}]({file}-{name.replace(' ', '-')}.png)" for name in names]
        parts += [f"### {title}\n", *pictures, ""]
    return "\n".join(parts)
