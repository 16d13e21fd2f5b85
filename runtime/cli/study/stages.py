"""What each stage is worth: the pipeline with one stage taken out or put back to what the paper has."""

from dataclasses import replace

from processing.odometry import OdometryConfig
from processing.slam import SlamConfig

WHOLE = "whole pipeline"
MATCHER = "matcher alone"


def variants() -> dict[str, OdometryConfig | SlamConfig]:
    """Return the configurations to compare, by what they leave out; the first two leave out nothing of it."""
    odometry = OdometryConfig()
    matching, search = odometry.matching, odometry.matching.search
    no_search = replace(matching, search=replace(search, generations=0))
    paper_search = replace(search, population=100, generations=50, factor=1.0, crossover=0.95)
    ndt = odometry.ndt
    return {
        WHOLE: SlamConfig(),
        MATCHER: odometry,
        "without de-skew": replace(odometry, deskew=False),
        "every point, no resampling": replace(odometry, resampling=replace(odometry.resampling, points=0)),
        "no evolution, Newton alone": replace(odometry, matching=no_search),
        "no Newton, evolution alone": replace(odometry, matching=replace(matching, polish=False)),
        "evolution with the paper's Table 1": replace(
            odometry, matching=replace(matching, search=paper_search)
        ),
        "flat cells as they are": replace(odometry, ndt=replace(ndt, flat_stretch=1.0)),
        "against the previous scan (the paper)": replace(odometry, reference="previous_scan"),
    }
