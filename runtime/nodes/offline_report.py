"""What the page about a run needs of each step, kept in a few numbers, and the page made of them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.se2 import Pose
from processing.slam import Step
from runtime.reports.report import ReportData, page


class Diary:
    """Takes the steps of a run; `tell` makes the page."""

    def __init__(self) -> None:
        self.states: list[str] = []
        self._score: list[float] = []
        self._points: list[int] = []
        self._sigma_m: list[NDArray[np.float64]] = []
        self._n_eff: list[float] = []
        self._resampled: list[bool] = []
        self._particles: Pose = np.zeros((0, 3))

    def take(self, step: Step) -> None:
        """Note one step."""
        match, mapping = step.match, step.mapping
        self.states.append(match.state.name)
        self._score.append(match.score)
        self._points.append(len(match.points_laser))
        variances = np.linalg.eigvalsh(match.motion.covariance[:2, :2])
        sigma_m = np.sqrt(np.maximum(variances, 0.0))
        self._sigma_m.append(np.full(2, np.nan) if match.motion.lost or match.motion.anew else sigma_m)
        self._n_eff.append(mapping.n_eff)
        self._resampled.append(mapping.resampled)
        self._particles = mapping.particles

    def tell(
        self,
        title: str,
        picture: bytes,
        stamps_ns: NDArray[np.int64],
        map_t_laser: Pose,
        *,
        known_m2: float,
        facts: Mapping[str, Any],
        notices: Sequence[str],
        config: str,
        ancestors: NDArray[np.int16],
    ) -> str:
        """Return the page of the run.

        Args:
            title: What was mapped.
            picture: The map, PNG.
            stamps_ns: (N,) of every step, in order.
            map_t_laser: (N, 3).
            known_m2: Area that was seen.
            facts: Versions, seed, host, input.
            notices: What the log's reader had to say.
            config: YAML.
            ancestors: (P, K) of each particle, at each key scan.
        """
        return page(
            ReportData(
                title=title,
                picture=picture,
                known_m2=known_m2,
                stamps_ns=stamps_ns,
                map_t_laser=map_t_laser,
                states=self.states,
                score=np.array(self._score),
                points=np.array(self._points, dtype=np.int64),
                sigma_m=np.array(self._sigma_m).reshape(-1, 2),
                n_eff=np.array(self._n_eff),
                resampled=np.array(self._resampled, dtype=np.bool_),
                particles=self._particles,
                ancestors=ancestors,
                facts=facts,
                notices=notices,
                config=config,
            )
        )
