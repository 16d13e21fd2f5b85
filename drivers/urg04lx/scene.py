"""What an emulated sensor sees."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Scene = Callable[[NDArray[np.int64]], NDArray[np.int32]]
"""Times of the 682 rays of a sweep (ns, the emulator's clock) to what each sees: mm, or a code below 20."""


def still_room(seed: int = 0, width_m: float = 4.0, depth_m: float = 3.0, noise_mm: float = 3.0) -> Scene:
    """Stand in the middle of an empty rectangular room, with the noise and the errors of a real sensor."""
    rng = np.random.default_rng(seed)
    bearings = (np.arange(44, 726) - 384) * 2.0 * np.pi / 1024
    with np.errstate(divide="ignore"):
        room_m = np.minimum(width_m / 2 / np.abs(np.cos(bearings)), depth_m / 2 / np.abs(np.sin(bearings)))

    def scene(ray_times_ns: NDArray[np.int64]) -> NDArray[np.int32]:
        count = len(ray_times_ns)
        seen = np.rint(room_m * 1000 + noise_mm * rng.standard_normal(count)).astype(np.int32)
        # The sensor smooths: two in five neighbours are exactly equal.
        source = np.where(rng.random(count) < 0.4, 0, np.arange(count))
        seen = seen[np.maximum.accumulate(source)]
        lost = rng.random(count) < 0.03
        seen[lost] = rng.choice((0, 6, 7, 9), count)[lost]
        return seen

    return scene
