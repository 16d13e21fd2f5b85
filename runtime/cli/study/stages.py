"""What each stage is worth: the pipeline with one stage taken out or put back to what the paper has."""

from dataclasses import replace

from processing.dpslam.config import DpSlamConfig
from processing.evolution import TABLE_1
from processing.odometry import OdometryConfig
from processing.slam import SlamConfig

WHOLE = "whole pipeline"
MATCHER = "matcher alone"
PAPER = "the paper's chain"

ABOUT = {
    WHOLE: "matcher and mapper as they come",
    MATCHER: "no map but the local one; the rows from 'without de-skew' on are this, with one change",
    "DP-SLAM without loops": "fifty particles, but the path is not bent where the laser comes back",
    "one particle, without loops": "the same with one map",
    "without de-skew": "all rays of a sweep are taken to be of one moment",
    "every point, no resampling": "682 points are matched in place of some 134",
    "no evolution, Newton alone": "Newton's method, begun where the velocity so far puts the laser",
    "no Newton, evolution alone": "the best member of differential evolution is the answer",
    "evolution with the paper's Table 1": "100 members, 50 generations, F 1, CR 0.95; then Newton",
    "a point weighs 1": "in place of 0.4: as if neighbouring points did not err alike",
    "wide cells only": "without the cells of half the width",
    "walls not filled in": "nothing is added between two rays that met one wall",
    "flat cells as they are": "a cell on a wall holds along the wall, too, as far as its few points reach",
    "a reference of resampled points": "the local map has the points that were matched, not all",
    "against the last key scan": "in place of the local map of the last forty",
    "against the previous scan": "the same with the scan before",
    PAPER: "previous scan, resampled points, wide cells as they are, Table 1, no Newton",
}
"""What each of the variants is, in words."""


def variants() -> dict[str, OdometryConfig | SlamConfig]:
    """Return the configurations to compare, by what they leave out; the first two leave out nothing of it."""
    odometry = OdometryConfig()
    matching, search, ndt = odometry.matching, odometry.matching.search, odometry.ndt
    no_search = replace(matching, search=replace(search, generations=0))
    as_printed = replace(
        search,
        population=TABLE_1.population,
        generations=TABLE_1.generations,
        factor=TABLE_1.factor,
        crossover=TABLE_1.crossover,
    )
    return {
        WHOLE: SlamConfig(),
        MATCHER: odometry,
        "DP-SLAM without loops": SlamConfig(mapping=DpSlamConfig(close_loops=False)),
        "one particle, without loops": SlamConfig(mapping=DpSlamConfig(close_loops=False, particles=1)),
        "without de-skew": replace(odometry, deskew=False),
        "every point, no resampling": replace(odometry, resampling=replace(odometry.resampling, points=0)),
        "no evolution, Newton alone": replace(odometry, matching=no_search),
        "no Newton, evolution alone": replace(odometry, matching=replace(matching, polish=False)),
        "evolution with the paper's Table 1": replace(
            odometry, matching=replace(matching, search=as_printed)
        ),
        "a point weighs 1": replace(odometry, matching=replace(matching, score_weight=1.0)),
        "wide cells only": replace(odometry, ndt=replace(ndt, fine_cell_m=0.0)),
        "walls not filled in": replace(odometry, fill_m=0.0),
        "flat cells as they are": replace(odometry, ndt=replace(ndt, flat_stretch=1.0)),
        "a reference of resampled points": replace(odometry, reference_points="resampled"),
        "against the last key scan": replace(odometry, reference="key_scan"),
        "against the previous scan": replace(odometry, reference="previous_scan"),
        PAPER: replace(
            odometry,
            reference="previous_scan",
            reference_points="resampled",
            fill_m=0.0,
            ndt=replace(ndt, fine_cell_m=0.0, flat_stretch=1.0),
            matching=replace(matching, search=as_printed, polish=False),
        ),
    }


def of_a_log() -> tuple[str, ...]:
    """Return which of them are worth a look where nobody knows the truth."""
    return (WHOLE, MATCHER, "DP-SLAM without loops", PAPER)
