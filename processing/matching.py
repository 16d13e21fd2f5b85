"""A scan against a reference: the most probable pose, given the score of the scan and what the motion says.

Differential evolution searches a box on the sampled score, Newton's method polishes on the exact one. Weighed
together they are a log-posterior: weight * score + log prior.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from processing.evolution import EvolutionConfig, random_state
from processing.matching_kernels import polish, search
from processing.ndt import Ndt, Oriented, Points, oriented
from processing.prediction import LEAST_INFORMATION, Prior
from processing.se2 import Pose, wrap

Matrix = NDArray[np.float64]


PARTS = 6
"""A sweep is cut in so many to ask when it saw what it tells."""
REACH_SIGMAS = 2.5
"""Where the prior allows more than the configured window, it is searched up to so many of its sigmas,"""
MOST_REACH_M = 1.2
"""but not so far that the next door of a corridor is in reach."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchingConfig:
    """Search, polish, and how much they trust the scan against the motion."""

    search: EvolutionConfig = field(default_factory=EvolutionConfig)
    window_m: float = 0.3
    """Half side of the searched box around the prior; where the prior is vague, more is searched."""
    window_rad: float = 0.4
    """The same in rotation."""
    polish: bool = True
    """Whether Newton's method goes on from the best place that the search found."""
    score_weight: float = 0.4
    """Log-likelihood of one point that fits: neighbouring points err alike, and a person is many points."""
    freedom: float = 4.0
    """Degrees of freedom of the motion prior in the search: few forgive what the filter did not foresee."""
    coarse_deviation_m: float = 0.03
    """The polish starts with cells widened by this, and ends with the cells as they are."""
    fine_share: float = 0.5
    """Share of the fine cells at the end of the polish, where the reference has them."""

    def __post_init__(self) -> None:
        if not 0.0 < self.window_m <= 20.0:
            raise ValueError(f"window_m = {self.window_m}, must be in (0, 20]")
        if not 0.0 < self.window_rad <= np.pi:
            raise ValueError(f"window_rad = {self.window_rad}, must be in (0, pi]")
        if not 0.0 < self.score_weight <= 10.0:
            raise ValueError(f"score_weight = {self.score_weight}, must be in (0, 10]")
        if not self.freedom > 0.0:
            raise ValueError(f"freedom = {self.freedom}, must be positive")
        if not 0.0 <= self.fine_share <= 1.0:
            raise ValueError(f"fine_share = {self.fine_share}, must be in [0, 1]")
        if not 0.0 <= self.coarse_deviation_m <= 1.0:
            raise ValueError(f"coarse_deviation_m = {self.coarse_deviation_m}, must be in [0, 1]")


@dataclass(frozen=True, slots=True, eq=False)
class Matching:
    """Where a scan fits a reference."""

    pose: Pose
    """(3,) of the scan in the reference's frame."""
    score: float
    """Mean point score at the pose, 0 (nothing fits) to 1 (every point in the middle of its cells)."""
    hessian: Matrix
    """(3, 3) of the weighted score at the pose, reference axes."""
    information: Matrix
    """(3, 3) Gauss-Newton information of the weighted score, reference axes; without the prior."""
    generations: int
    evaluations: int
    polish_steps: int


class Matcher:
    """Matches scans against references; its random numbers go on from match to match."""

    def __init__(self, config: MatchingConfig, seed: int = 0) -> None:
        self.config = config
        self._state = random_state(seed)
        size = config.search.population
        self._population = np.empty((size, 3))
        self._values = np.empty(size + 2)
        self._rule = config.search.rule()
        self._stages = np.array(((config.coarse_deviation_m**2, 0.0), (0.0, config.fine_share)))
        self._curvature = np.empty((2, 3, 3))
        self._report = np.zeros(3)

    def match(
        self,
        points: Points | Oriented,
        reference: Ndt,
        prior: Prior,
        window: NDArray[np.float64] | None = None,
    ) -> Matching:
        """Find the most probable pose of points in the reference.

        Args:
            points: (N, 2), or (N, 4) with the walls that they are on, which the polish heeds; the search
                has no need of them.
            reference: What they are matched against.
            prior: Where they should be.
            window: (3,) half sides of the searched box, if other than the configured ones.
        """
        points, config = oriented(points), self.config
        given = np.empty(14)
        given[:3] = prior.pose
        given[3:12] = prior.information.ravel()
        given[12] = config.freedom
        given[13] = config.score_weight
        half = np.array((config.window_m, config.window_m, config.window_rad)) if window is None else window
        bounds = np.stack((prior.pose - half, prior.pose + half))
        pose = prior.pose.copy()
        generations = evaluations = 0
        if config.search.generations > 0 and len(points) > 0:
            best = search(
                points,
                reference.origin,
                reference.slots,
                reference.tiles,
                given,
                bounds,
                self._rule,
                self._population,
                self._values,
                self._state,
            )
            pose = self._population[best].copy()
            generations, evaluations = int(self._values[-2]), int(self._values[-1])
        steps = 0
        if config.polish:
            fine = reference if reference.fine is None else reference.fine
            self._stages[1, 1] = 0.0 if reference.fine is None else config.fine_share
            score = polish(
                points,
                reference.grid,
                fine.grid,
                given,
                self._stages,
                pose,
                self._curvature,
                self._report,
            )
            steps = int(self._report[0])
            hessian, information = self._curvature
        else:
            found = reference.score(points, pose)
            score, hessian, information = found.value, found.hessian, found.information
        pose[2] = wrap(pose[2])
        return Matching(
            pose=pose,
            score=float(score) / max(len(points), 1),
            hessian=config.score_weight * hessian,
            information=config.score_weight * information,
            generations=generations,
            evaluations=evaluations,
            polish_steps=steps,
        )

    def telling_s(
        self, points: Oriented, seen_s: NDArray[np.float64], reference: Ndt, matching: Matching
    ) -> Matrix:
        """Return when what a match tells was seen: the mean time of the points, weighed by their information.

        Args:
            points: (N, 4) in the order of their rays, and
            seen_s: (N,) when each was seen.
            reference: What they were matched against.
            matching: Where they fit.

        Returns:
            (3, 3), reference axes: what a twist (3,) has moved the points by when they were seen.
        """
        weighed, total = np.zeros((3, 3)), LEAST_INFORMATION * np.eye(3)
        for part in np.array_split(np.arange(len(points)), PARTS):
            if len(part):
                information = self.information(points[part], reference, matching.pose)
                weighed += float(seen_s[part].mean()) * information
                total += information
        return np.asarray(np.linalg.solve(total, weighed))

    def reach(self, prior: Prior) -> NDArray[np.float64]:
        """Return the half sides (3,) of the box to search: as configured, more where the prior is vague."""
        config = self.config
        doubt_m = np.sqrt(np.diag(np.linalg.inv(prior.information))[:2])
        x_m, y_m = np.clip(REACH_SIGMAS * doubt_m, config.window_m, max(config.window_m, MOST_REACH_M))
        return np.array((x_m, y_m, config.window_rad))

    def log_ratio(self, points: Oriented, reference: Ndt, one: Pose, other: Pose) -> float:
        """Return how much more probable points (N, 4) are at one pose (3,) than at another: a logarithm."""
        return self._log_likelihood(points, reference, one) - self._log_likelihood(points, reference, other)

    def _log_likelihood(self, points: Oriented, reference: Ndt, pose: Pose) -> float:
        return sum(share * cells.score(points, pose).value for share, cells in self._mixture(reference))

    def _mixture(self, reference: Ndt) -> list[tuple[float, Ndt]]:
        """Return the cells that the polish ends in, and what a point that fits them is worth."""
        weight, share = self.config.score_weight, self.config.fine_share
        if not self.config.polish or reference.fine is None:
            return [(weight, reference)]
        return [(weight * (1.0 - share), reference), (weight * share, reference.fine)]

    def has_turned_on(self, pose: Pose, prior: Prior) -> bool:
        """Whether a pose (3,) is turned by more than the search around a prior reaches: the polish did."""
        return bool(abs(wrap(pose[2] - prior.pose[2])) > self.config.window_rad)

    def information(self, points: Points | Oriented, reference: Ndt, pose: Pose) -> Matrix:
        """Return the information (3, 3) that points alone give at a pose, as in `Matching`."""
        points, total = np.ascontiguousarray(points), np.zeros((3, 3))
        for share, cells in self._mixture(reference):
            total += share * cells.score(points, pose).information
        return total
