"""The tables of the study (settings, each building, what each stage is worth, logs) and its figures."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from processing.evolution import TABLE_1
from processing.odometry import OdometryConfig
from runtime.cli.study import stages
from runtime.cli.study.document import Block, Figure, Heading, Table, Words
from runtime.cli.study.work import HURRY, Numbers


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table: the key of its numbers, its title, how they are written, and what they are."""

    key: str
    title: str
    form: str
    about: str


_STATES = (
    Column("lost", "lost", "{:.0f}", "scans that fitted nowhere"),
    Column("degenerate", "one direction unseen", "{:.0f}", "scans whose state is DEGENERATE"),
    Column("ms", "ms a scan", "{:.1f}", "CPU time of one core, mean"),
)
_FOLLOWED = (
    Column("match_mm", "each match, mm", "{:.1f}", "error of the motion from one sweep to the next"),
    Column("ahead_mm", "along, mm", "{:.1f}", "its part along the laser's heading"),
    Column("aside_mm", "across, mm", "{:.1f}", "its part across that"),
    Column("match_deg", "turn, deg", "{:.2f}", "its rotation"),
    Column("stretch_mm", "over 1 m, mm", "{:.0f}", "error of the motion over a metre of way"),
    Column("ate_m", "whole way, m", "{:.3f}", "error of the positions, the whole way laid on the true one"),
    Column("max_m", "greatest, m", "{:.3f}", "the greatest of these errors"),
    *_STATES,
)
_LOGGED = (
    Column("scans", "scans", "{:.0f}", "of the log"),
    Column("entropy", "entropy of the map, nat", "{:.3f}", "mean of its cells: the lower, the crisper"),
    Column(
        "conflict", "rays through walls", "{:.2%}", "end points in cells that more rays crossed than ended in"
    ),
    *_STATES,
)
_FIGURES = (
    (
        "fig2-resampling",
        "2. What resampling keeps",
        "All points of one sweep, and those that saliency-based resampling keeps of it: corners and ends of"
        " walls densely, long straight walls thinly.",
    ),
    (
        "fig4-evolution",
        "4. How the search closes in",
        "The members of differential evolution in the window that is searched for the pose of a sweep: the"
        " dot is the place, the stroke the heading. Here the search does not end when all of them meet.",
    ),
    (
        "fig5-matching",
        "5. A match",
        "A sweep (blue) on an earlier one (black), where the search begins and where it ends; and how the"
        " score a point rose, best member and mean of all, with the paper's Table 1 and with the default.",
    ),
    (
        "fig6-way",
        "6. The way by the matcher alone",
        "Red: the way; blue: all hits, placed by it; grey: the true way, where it is known.",
    ),
    (
        "fig7-way",
        "7. The way by matcher and mapper",
        "As in figure 6, with the mapper's corrections.",
    ),
    (
        "fig8-map",
        "8. The map",
        "White: free; black: wall; grey ground: not seen; red: the way; grey line: the true way.",
    ),
    (
        "fig9-particles",
        "9. The particles",
        "Red: the way of the best particle, key scan by key scan; purple: the ways of the others, thirty"
        " times as far from it as they are: at their own size they would lie within the red line. Where no"
        " purple is seen they agree to a millimetre or so. The caption says how many key scans, from the"
        " start on, all particles have in common, because they descend from one.",
    ),
)
BLIND_SHARE = 0.05
"""A building is left out of the means if on more of its scans one direction is not seen."""


def page(
    buildings: Mapping[str, Numbers], hurried: Mapping[str, Numbers], logs: Mapping[str, Numbers]
) -> list[Block]:
    """Return the tables.

    Args:
        buildings: Errors by building and variant.
        hurried: The same of the hurried drives.
        logs: Figures by log and variant.
    """
    parts: list[Block] = [
        Heading("The method in numbers", 1),
        Words("Made by the command hallway paper; rms where nothing else is said."),
        Heading("Settings (the paper's Table 1)"),
        _settings(),
    ]
    if buildings:
        whole = {name: numbers[stages.WHOLE] for name, numbers in buildings.items()}
        alone = {name: numbers[stages.MATCHER] for name, numbers in buildings.items()}
        compared = seen_buildings(buildings)
        parts += [
            Heading("Each building"),
            Words("Errors against the truth of drives with the noise of a URG-04LX, by the whole pipeline."),
            _table(whole, "building", _FOLLOWED),
            Words("By the matcher alone:"),
            _table(alone, "building", _FOLLOWED),
            Heading("What each stage is worth"),
            Words(_compared(compared, list(buildings))),
            _table(_means(buildings, compared or buildings), "pipeline", _FOLLOWED),
            Words(f"The same drives {HURRY} times as fast: only every {HURRY}th sweep is seen."),
            _table(_means(hurried, compared or buildings), "pipeline", _FOLLOWED),
            Heading("What the rows are"),
            Table(("pipeline", "what is different"), list(stages.ABOUT.items())),
            Heading("What the columns are"),
            _key_to(_FOLLOWED),
        ]
    for name, numbers in logs.items():
        parts += [
            Heading(name),
            Words("Nobody knows the truth; low entropy and few rays through walls are a crisp map."),
            _table({variant: numbers[variant] for variant in stages.of_a_log()}, "pipeline", _LOGGED),
        ]
    if logs:
        parts += [Heading("What the columns of a log are"), _key_to(_LOGGED)]
    return parts


def figures(names: Sequence[str]) -> list[Block]:
    """Return the figures of these drives, each kind with its explanation."""
    parts: list[Block] = [Heading("Figures")]
    for file, title, explanation in _FIGURES:
        parts += [Heading(title, 3), Words(explanation)]
        parts += [Figure(f"{file}-{name.replace(' ', '-')}.png", name) for name in names]
    return parts


def seen_buildings(buildings: Mapping[str, Numbers]) -> list[str]:
    """Return the buildings in which the matcher sees all directions, but for a small share of the scans.

    In a bare corridor nobody can know how far the laser went: its error would drown every difference.
    """
    alone = {name: numbers[stages.MATCHER] for name, numbers in buildings.items()}
    return [name for name, row in alone.items() if row["degenerate"] <= BLIND_SHARE * row["scans"]]


def _compared(names: Sequence[str], all_names: Sequence[str]) -> str:
    if not names:
        return (
            f"Means over {_listed(all_names)}; lost and unseen are sums. In each of them one direction is"
            f" unseen on more than {100 * BLIND_SHARE:g} % of the scans, and what was driven there unseen"
            " drowns the differences between the stages: these means compare little."
        )
    return (
        f"Means over {_listed(names)}, where one direction is unseen on {100 * BLIND_SHARE:g} % of the"
        " scans at most (by the matcher alone); lost and unseen are sums. In a bare corridor no laser knows"
        " how far it went; what counts is that it says so: see above."
    )


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _settings() -> Table:
    ours = OdometryConfig()
    search, ndt = ours.matching.search, ours.ndt
    fine = f" and {ndt.fine_cell_m:g}" if ndt.fine_cell_m else ""
    rows = (
        ("NDT cell, m", "0.5", f"{ndt.cell_m:g}{fine}"),
        ("members, NP", str(TABLE_1.population), str(search.population)),
        ("generations, G", str(TABLE_1.generations), f"{search.generations} at most"),
        ("factor, F", f"{TABLE_1.factor:g}", f"{search.factor:g}"),
        ("crossover, CR", f"{TABLE_1.crossover:g}", f"{search.crossover:g}"),
        (
            "ends",
            "at a score found by trial, or at G",
            "when all members meet, or at G; then Newton's method",
        ),
        ("reference", "previous scan", f"the last {ours.key_scans} key scans"),
    )
    return Table(("", "paper", "Hallway"), rows)


def _key_to(columns: Sequence[Column]) -> Table:
    return Table(("column", "what it is"), [(column.title, column.about) for column in columns])


def _means(numbers: Mapping[str, Numbers], names: Collection[str]) -> Numbers:
    return {variant: _mean([numbers[name][variant] for name in names]) for variant in stages.variants()}


def _mean(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    sums = ("lost", "degenerate")
    return {key: float((np.sum if key in sums else np.mean)([row[key] for row in rows])) for key in rows[0]}


def _table(rows: Mapping[str, Mapping[str, Any]], first: str, columns: Sequence[Column]) -> Table:
    titles = (first, *(column.title for column in columns))
    return Table(
        titles,
        [(name, *(_cell(row[column.key], column.form) for column in columns)) for name, row in rows.items()],
    )


def _cell(value: float, form: str) -> str:
    """Return a value as it is shown; nothing where there is none, as over 1 m of a shorter way."""
    return "" if np.isnan(value) else form.format(value)
