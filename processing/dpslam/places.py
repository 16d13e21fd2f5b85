"""Where key scans were found to lie on what earlier ones saw: the relations that bend a path."""

import numpy as np
from numpy.typing import NDArray

from processing.growing import Growing
from processing.se2 import Pose

DOUBT = 12.0
"""Chi-square at which a place is doubted: 3 degrees of freedom pass it once in a hundred."""


class Places:
    """Relations of key scans to settled ones, in the order in which they were found."""

    def __init__(self) -> None:
        self.ends = Growing((2,), np.int64)
        """(N, 2) numbers of the settled key scan and of the one that was seen from it,"""
        self.poses = Growing((3,))
        """(N, 3) where,"""
        self.informations = Growing((3, 3))
        """(N, 3, 3) how well that is known,"""
        self.doubts = Growing()
        """(N,) and the chi-square at which it is doubted, 0 for never."""

    def __len__(self) -> int:
        return len(self.doubts)

    def add(self, ends: tuple[int, int], pose: Pose, information: NDArray[np.float64], doubt: float) -> None:
        """Append one."""
        self.ends.append(ends)
        self.poses.append(pose)
        self.informations.append(information)
        self.doubts.append(doubt)
