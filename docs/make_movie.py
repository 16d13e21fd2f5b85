"""Make the moving picture of the README: `python docs/make_movie.py` (two minutes of one core).

The demo's building is driven around with a simulated URG-04LX, in simulated time; each frame shows what the
pipeline has made of the scans so far: the map, the way in red, the hits of the newest scan in blue.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))

from processing.se2 import transform
from processing.slam import Slam
from runtime.cli.study.drives import drive
from runtime.reports.picture import HITS, PATH, START, render

TO = Path(__file__).parent / "pictures" / "growing-map.gif"
EVERY = 45
FRAME_MS, LAST_MS = 90, 3500
SIZE_PX = 850
COLOURS = 48
MARGIN_M = 0.4


def main() -> None:
    """Drive, draw, write."""
    driven = drive("floor", 100_000, seed=1)
    slam = Slam(seed=1)
    moments = []
    for number, scan in enumerate(driven.scans):
        step = slam.step(scan)
        if number % EVERY == 0 or number == len(driven.scans) - 1:
            _, path = slam.trajectory()
            hits = transform(step.mapping.map_t_laser, step.match.points_laser)
            moments.append((number, slam.occupancy(), path, hits))
    grid = moments[-1][1]
    low = np.array(grid.origin_m)
    known = np.argwhere(~np.isnan(grid.probability))[:, ::-1] * grid.resolution_m + low
    bounds = (*(known.min(axis=0) - MARGIN_M), *(known.max(axis=0) + MARGIN_M))
    frames = [
        render(
            now.probability,
            now.resolution_m,
            now.origin_m,
            path,
            hits=hits,
            hit_px=2.0,
            caption=f"{number / 10:3.0f} s   one laser of 4 m reach, nothing else",
            size_px=SIZE_PX,
            bounds_m=bounds,
        )
        for number, now, path, hits in moments
    ]
    # One palette for all, from a frame with every colour large enough to count: what stays costs nothing.
    every = frames[len(frames) // 2].copy()
    for k, colour in enumerate((HITS, PATH, START)):
        every.paste(colour, (0, 40 * k, 40, 40 * k + 40))
    palette = every.quantize(COLOURS, dither=Image.Dither.NONE)
    few = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    lasts = [FRAME_MS] * (len(few) - 1) + [LAST_MS]
    few[0].save(TO, save_all=True, append_images=few[1:], duration=lasts, loop=0, optimize=True)
    sys.stdout.write(f"{TO.name}: {len(few)} frames, {few[0].size}, {TO.stat().st_size / 1000:.0f} kB\n")


if __name__ == "__main__":
    main()
