"""A sweep taken while the laser changed its turn rate is bent; it is straight at the rate at which it fits.

A scanner that takes a fifth of a second for a revolution turns with its robot by ten degrees meanwhile. What
the rate was until then says little of a turn that has just begun, and a sweep set right by a wrong rate fits
nowhere. So where a scan fits badly, turn rates are tried, each with the place that it leads to.
"""

import copy
from dataclasses import replace

import numpy as np

from processing.matching import Matcher, MatchingConfig
from processing.ndt import Ndt
from processing.prediction import ConstantVelocity
from processing.saliency import Resampler
from processing.scan import Scan

LEAST_BEND_RAD = 0.06
"""Sweeps that an unforeseen turn bends less, one sigma from the middle to an end, fit all the same: a tenth
of a metre two metres away. A URG-04LX is among them, and whatever takes a tenth of a second or less."""
RATES = np.array((-1.2, -0.8, -0.4, 0.0, 0.4, 0.8, 1.2))
"""Turn rates that are tried, in sigmas from the expected one."""
RATE_SHARE = 0.15
"""How well the best of them is known, a share of what the expected one was."""


class Straightener:
    """Finds the turn rate during a sweep by how well the sweep fits.

    Args:
        config: Of the odometry's matcher.
        walls: Whether points know the walls that they are on.
    """

    def __init__(self, config: MatchingConfig, walls: bool) -> None:
        self._walls = walls
        # The places that the rates lead to are near enough for the polish alone.
        self._polish = Matcher(replace(config, search=replace(config.search, generations=0)))

    def straighten(
        self,
        scan: Scan,
        resampler: Resampler,
        filter_: ConstantVelocity,
        middle_s: float,
        reference: Ndt,
        least_score: float,
    ) -> bool:
        """Correct the filter by the turn rate at which a scan fits; return whether there is one.

        Args:
            scan: What the laser sees.
            resampler: Of the scanner; its points are set right by the rate that the filter has in the end.
            filter_: Where the scan is expected.
            middle_s: From its first ray to the instant that poses are of.
            reference: The local map.
            least_score: What the scan must score, or something else is amiss with it.
        """
        doubt = float(np.sqrt(filter_.covariance[5, 5]))
        if doubt * middle_s < LEAST_BEND_RAD:
            return False
        expected = float(filter_.twist[2])

        def fit(sigmas: float) -> float:
            tried = copy.copy(filter_)
            prior = tried.see_turn(expected + sigmas * doubt, RATE_SHARE * doubt)
            resampler.points(scan, tried.twist, middle_s)
            return self._polish.match(resampler.oriented_means(self._walls), reference, prior).score

        scores = np.array([fit(sigmas) for sigmas in RATES])
        best, told = int(scores.argmax()), False
        if 0 < best < len(RATES) - 1:
            below, here, above = scores[best - 1 : best + 2]
            # The top of the parabola through the best rate and its neighbours.
            aside = 0.5 * (below - above) / (below - 2.0 * here + above)
            sigmas = RATES[best] + aside * (RATES[1] - RATES[0])
            told = fit(sigmas) >= least_score
            if told:
                filter_.see_turn(expected + sigmas * doubt, RATE_SHARE * doubt)
        resampler.points(scan, filter_.twist, middle_s)
        return told
