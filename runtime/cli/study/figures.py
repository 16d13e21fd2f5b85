"""The figures: what resampling keeps, how evolution closes in, ways with their hits, maps, particles."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from processing.evolution import TABLE_1, EvolutionConfig, maximise, random_state
from processing.ndt import Ndt, NdtConfig
from processing.odometry import OdometryConfig
from processing.saliency import Resampler
from processing.scan import end_points
from processing.se2 import Pose, transform
from runtime.cli.study import curves
from runtime.cli.study.drives import Drive, Followed
from runtime.reports.picture import FREE, HITS, INK, PATH, TRUTH, render

SIZE_PX = 900
_EMPTY = np.full((1, 1), np.nan, dtype=np.float32)
_CELL_M = 0.05
_MAGNIFIED = 30
_MARGIN_M = 0.5


def resampling(drive: Drive, number: int) -> Image.Image:
    """Draw one sweep before and after resampling (the paper's figure 2)."""
    scan = drive.scans[number]
    every, _ = end_points(scan, np.zeros(3))
    resampler = Resampler(OdometryConfig().resampling, scan.beams)
    resampler.points(scan, np.zeros(3))
    kept = resampler.means()
    low, high = every.min(axis=0) - _MARGIN_M, every.max(axis=0) + _MARGIN_M
    ground = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    pictures = [
        _points(points, f"{len(points)} {words}", ground)
        for points, words in ((every, "points of the sweep"), (kept, "points kept"))
    ]
    return beside(pictures)


def evolution(drive: Drive, number: int, seed: int) -> Image.Image:
    """Draw where the members of the search are after some generations (the paper's figure 4)."""
    ndt, _, scan = _pair(drive, number)
    half = np.array((0.5, 0.5, 0.3))
    frames = []
    for generations in (0, 5, 15, 40):
        search = EvolutionConfig(population=60, generations=generations, factor=0.7, spread=(0.0, 0.0, 0.0))
        found = maximise(
            lambda pose: ndt.score(scan, pose).value, np.stack((-half, half)), search, random_state(seed)
        )
        frames.append(_members(found.population, half, f"generation {generations}"))
    return beside(frames)


def matching(drive: Drive, number: int, seed: int) -> Image.Image:
    """Draw a sweep before and after its match, and how the search went (the paper's figure 5)."""
    ndt, reference, scan = _pair(drive, number)
    guess, half = np.array((0.3, -0.25, 0.2)), np.array((0.5, 0.5, 0.4))
    box = np.stack((guess - half, guess + half))
    searches = {"Table 1": TABLE_1, "default": OdometryConfig().matching.search}
    curved: dict[str, NDArray[np.float64]] = {}
    found: Pose = guess
    for name, search in searches.items():
        values: list[float] = []

        def score(pose: NDArray[np.float64], seen: list[float] = values) -> float:
            seen.append(ndt.score(scan, pose).value / len(scan))
            return seen[-1]

        found = maximise(score, box, replace(search, spread=(0.0, 0.0, 0.0)), random_state(seed)).place
        # A member is replaced by a better one only: its value so far is the greatest of its trials.
        members = np.maximum.accumulate(np.reshape(values, (-1, search.population)), axis=0)
        curved[f"best, {name}"], curved[f"mean, {name}"] = members.max(axis=1), members.mean(axis=1)
    pictures = [
        _over(reference, transform(pose, scan), words)
        for pose, words in ((guess, "the guess"), (found, "the match"))
    ]
    # A corridor is a low picture, in which the curves would have no room.
    size_px = max(pictures[0].height, 320)
    return beside([*pictures, curves.plot(curved, "score by generation", size_px)])


def way(drive: Drive, followed: Followed, who: str) -> Image.Image:
    """Draw the way in red over all hits in blue, the truth in grey (the paper's figures 6 and 7)."""
    hits = followed.hits_map[:: max(1, len(followed.hits_map) // 20_000)]
    caption = f"{drive.name}: {len(drive.scans)} scans, {who}"
    path = followed.map_t_laser
    return render(
        _EMPTY, 0.05, (0.0, 0.0), path, truth=drive.truth, hits=hits, caption=caption, size_px=SIZE_PX
    )


def map_of(drive: Drive, followed: Followed) -> Image.Image:
    """Draw the map of the whole pipeline, the truth in grey (the paper's figure 8)."""
    grid = followed.grid
    if grid is None:
        raise ValueError("a drive that was followed without a map")
    caption = f"{drive.name}: {len(drive.scans)} scans, matcher and mapper"
    way = followed.map_t_laser
    return render(
        grid.probability,
        grid.resolution_m,
        grid.origin_m,
        way,
        truth=drive.truth,
        caption=caption,
        size_px=SIZE_PX,
    )


def particles(drive: Drive, followed: Followed) -> Image.Image:
    """Draw the way of each particle, thirty times as far off the best one as it is (the paper's figure 9).

    Particles agree to centimetres; at their own size their ways are one line.
    """
    best, *others = followed.lineages
    ways = [(best + _MAGNIFIED * (other - best))[:, :2] for other in others]
    shared = int(np.sum(np.all([np.all(other == best, axis=1) for other in others], axis=0)))
    caption = (
        f"{drive.name}: {len(others) + 1} particles, {_MAGNIFIED} times as far apart as they are;"
        f" {shared} of {len(best)} key scans in common"
    )
    return render(_EMPTY, 0.05, (0.0, 0.0), best, others=ways, caption=caption, size_px=SIZE_PX)


def beside(pictures: Sequence[Image.Image]) -> Image.Image:
    """Put pictures side by side."""
    height = max(picture.height for picture in pictures)
    page = Image.new("RGB", (sum(p.width for p in pictures) + 12 * (len(pictures) - 1), height), FREE)
    at = 0
    for picture in pictures:
        page.paste(picture, (at, 0))
        at += picture.width + 12
    return page


def _pair(drive: Drive, number: int) -> tuple[Ndt, NDArray[np.float64], NDArray[np.float64]]:
    """Return the transform of a sweep, its points, and those of a sweep shortly after."""
    reference, scan = (_resampled(drive, n) for n in (number, number + 3))
    ndt = Ndt(NdtConfig(cell_m=OdometryConfig().ndt.cell_m))
    ndt.build(reference)
    return ndt, reference, scan


def _over(reference: NDArray[np.float64], scan: NDArray[np.float64], caption: str) -> Image.Image:
    """Draw a sweep in blue over another, in black cells."""
    corner = np.floor(reference.min(axis=0) / _CELL_M).astype(int)
    cells = np.floor(reference / _CELL_M).astype(int) - corner
    grid = np.full(tuple(cells.max(axis=0)[::-1] + 1), np.nan, dtype=np.float32)
    grid[cells[:, 1], cells[:, 0]] = 1.0
    origin = (float(corner[0] * _CELL_M), float(corner[1] * _CELL_M))
    bounds = (*(reference.min(axis=0) - 0.6), *(reference.max(axis=0) + 0.6))
    return render(grid, _CELL_M, origin, hits=scan, caption=caption, size_px=SIZE_PX // 2, bounds_m=bounds)


def _resampled(drive: Drive, number: int) -> NDArray[np.float64]:
    scan = drive.scans[number]
    resampler = Resampler(OdometryConfig().resampling, scan.beams)
    resampler.points(scan, np.zeros(3))
    return resampler.means()


def _points(
    points: NDArray[np.float64], caption: str, bounds_m: tuple[float, float, float, float]
) -> Image.Image:
    size_px = SIZE_PX // 2
    return render(_EMPTY, 0.05, (0.0, 0.0), hits=points, caption=caption, size_px=size_px, bounds_m=bounds_m)


def _members(population: NDArray[np.float64], half: NDArray[np.float64], caption: str) -> Image.Image:
    """Draw the members' x and y in the searched window; their yaw is the stroke."""
    size = 260
    picture = Image.new("RGB", (2 * size, 2 * size + 60), FREE)
    draw = ImageDraw.Draw(picture)
    draw.rectangle((2, 2, 2 * size - 3, 2 * size - 3), outline=TRUTH, width=2)
    for x, y, yaw in population:
        a = size * (1.0 + x / half[0])
        b = size * (1.0 - y / half[1])
        draw.line((a, b, a + 24 * np.cos(yaw), b - 24 * np.sin(yaw)), fill=HITS, width=2)
        draw.ellipse((a - 4, b - 4, a + 4, b + 4), fill=PATH)
    text = f"{caption}, {2 * half[0]:g} m window"
    draw.text((8, 2 * size + 28), text, fill=INK, font=ImageFont.load_default(28), anchor="lm")
    return picture.resize((size, size + 30), Image.Resampling.BOX)
