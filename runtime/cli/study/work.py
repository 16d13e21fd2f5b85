"""One drive through every variant of the pipeline: its numbers and its figures."""

from pathlib import Path

from processing.odometry import OdometryConfig
from processing.slam import SlamConfig
from runtime.cli.study import drives, figures, stages
from runtime.cli.study.drives import Drive, Followed
from runtime.reports.picture import png

HURRY = 5
"""Of the hurried drive only every so many-th scan is seen."""
Numbers = dict[str, dict[str, float]]


def study(where: str | Path, scans_max: int, out: Path, seed: int) -> tuple[str, Numbers, Numbers]:
    """Follow one drive in every variant and write its figures.

    Args:
        where: Name of a building, or a log.
        scans_max: Of the drive, at most.
        out: Folder of the figures.
        seed: Of noise and search.

    Returns:
        Name of the drive, errors of each variant, and those of the hurried drive (none for a log).
    """
    if isinstance(where, Path):
        driven = drives.logged(where, scans_max)
        hurried = None
    else:
        driven = drives.drive(where, scans_max, seed)
        hurried = drives.hurried(driven, HURRY)
    numbers, hasty = {}, {}
    for variant, config in stages.variants().items():
        if hurried is None and variant not in stages.of_a_log():
            continue
        followed = _followed(driven, config, seed)
        numbers[variant] = drives.errors(driven, followed)
        if variant in (stages.WHOLE, stages.MATCHER):
            _ways(driven, followed, variant, out)
        if hurried is not None:
            hasty[variant] = drives.errors(hurried, _followed(hurried, config, seed))
    middle, name = len(driven.scans) // 2, _file(driven)
    (out / f"fig2-resampling-{name}.png").write_bytes(png(figures.resampling(driven, middle)))
    (out / f"fig4-evolution-{name}.png").write_bytes(png(figures.evolution(driven, middle, seed)))
    (out / f"fig5-matching-{name}.png").write_bytes(png(figures.matching(driven, middle, seed)))
    return driven.name, numbers, hasty


def _followed(driven: Drive, config: OdometryConfig | SlamConfig, seed: int) -> Followed:
    if isinstance(config, SlamConfig):
        return drives.map_it(driven, config, seed)
    return drives.follow(driven, config, seed)


def _ways(driven: Drive, followed: Followed, variant: str, out: Path) -> None:
    name = _file(driven)
    if variant == stages.MATCHER:
        (out / f"fig6-way-{name}.png").write_bytes(png(figures.way(driven, followed, "matcher alone")))
        return
    (out / f"fig7-way-{name}.png").write_bytes(png(figures.way(driven, followed, "matcher and mapper")))
    (out / f"fig8-map-{name}.png").write_bytes(png(figures.map_of(driven, followed)))
    (out / f"fig9-particles-{name}.png").write_bytes(png(figures.particles(driven, followed)))


def _file(driven: Drive) -> str:
    return driven.name.replace(" ", "-")
