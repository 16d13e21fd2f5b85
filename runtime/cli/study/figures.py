"""The figures: what resampling keeps, how evolution closes in, the way with its hits, the maps."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from processing.evolution import EvolutionConfig, maximise, random_state
from processing.ndt import Ndt, NdtConfig
from processing.odometry import OdometryConfig
from processing.saliency import Resampler
from processing.scan import end_points
from runtime.cli.study.drives import Drive, Followed
from runtime.picture import FREE, HITS, INK, PATH, TRUTH, render

SIZE_PX = 900
_EMPTY = np.full((1, 1), np.nan, dtype=np.float32)


def resampling(drive: Drive, number: int) -> Image.Image:
    """Draw one sweep before and after resampling (the paper's figure 2)."""
    scan = drive.scans[number]
    every, _ = end_points(scan, np.zeros(3))
    resampler = Resampler(OdometryConfig().resampling, scan.beams)
    resampler.points(scan, np.zeros(3))
    kept = resampler.means()
    pictures = [
        _points(points, f"{len(points)} {words}")
        for points, words in ((every, "points of the sweep"), (kept, "points kept"))
    ]
    return beside(pictures)


def evolution(drive: Drive, number: int, seed: int) -> Image.Image:
    """Draw where the members of the search are after some generations (the paper's figure 4)."""
    config = OdometryConfig()
    reference, scan = (_resampled(drive, n) for n in (number, number + 3))
    ndt = Ndt(NdtConfig(cell_m=config.ndt.cell_m))
    ndt.build(reference)
    half = np.array((0.5, 0.5, 0.3))
    frames = []
    for generations in (0, 5, 15, 40):
        search = EvolutionConfig(population=60, generations=generations, factor=0.7, spread=(0.0, 0.0, 0.0))
        found = maximise(
            lambda pose: ndt.score(scan, pose).value, np.stack((-half, half)), search, random_state(seed)
        )
        frames.append(_members(found.population, half, f"generation {generations}"))
    return beside(frames)


def way(drive: Drive, followed: Followed) -> Image.Image:
    """Draw the way in red over all hits in blue, the truth in grey (the paper's figures 6 and 7)."""
    hits = followed.hits_map[:: max(1, len(followed.hits_map) // 20_000)]
    caption = f"{drive.name}: {len(drive.scans)} scans, matcher alone"
    path = followed.map_t_laser
    return render(
        _EMPTY, 0.05, (0.0, 0.0), path, truth=drive.truth, hits=hits, caption=caption, size_px=SIZE_PX
    )


def map_of(drive: Drive, followed: Followed) -> Image.Image:
    """Draw the map of the whole pipeline, the truth in grey (the paper's figures 8 and 9)."""
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


def beside(pictures: Sequence[Image.Image]) -> Image.Image:
    """Put pictures side by side."""
    height = max(picture.height for picture in pictures)
    page = Image.new("RGB", (sum(p.width for p in pictures) + 12 * (len(pictures) - 1), height), FREE)
    at = 0
    for picture in pictures:
        page.paste(picture, (at, 0))
        at += picture.width + 12
    return page


def _resampled(drive: Drive, number: int) -> NDArray[np.float64]:
    scan = drive.scans[number]
    resampler = Resampler(OdometryConfig().resampling, scan.beams)
    resampler.points(scan, np.zeros(3))
    return resampler.means()


def _points(points: NDArray[np.float64], caption: str) -> Image.Image:
    return render(_EMPTY, 0.05, (0.0, 0.0), hits=points, caption=caption, size_px=SIZE_PX // 2)


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
