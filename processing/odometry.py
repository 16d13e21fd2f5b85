"""Laser odometry: one scan in, one pose out, drifting but smooth.

The filter says where the scan should lie, the sweep is set right by the velocity, resampled, and matched
against the local map of the last key scans. Poses are of the middle of a sweep inside, where a wrong
velocity shifts nothing, and of its first ray outside, where the stamp is.
"""

import enum
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from processing.certainty import Certainty
from processing.cruise import Cruise
from processing.footing import Footing
from processing.local_map import LocalMap
from processing.matching import Matcher, Matching, MatchingConfig
from processing.motion import Motion, anew_covariance, doubted_covariance, lost_covariance
from processing.ndt import NdtConfig, Oriented
from processing.observability import Blindness, blind_m, deviation_m
from processing.prediction import ConstantVelocity, PredictionConfig, Prior, exponential, turned, weakened
from processing.recovery import shaded
from processing.saliency import Resampler, ResamplingConfig
from processing.scan import Beams, Scan
from processing.se2 import Pose, between, compose, snap_yaw, transform
from processing.straightening import Straightener
from processing.tracking import Watch

SLOW_SHARE = 0.8
"""A sweep that takes more of the time from scan to scan is slow."""
SHAKEN = np.array((0.05, 0.05, 0.015))
"""How far each motion may be off, one sigma, while something large moves before the laser; m, m, rad."""

Points = NDArray[np.float64]
Matrix = NDArray[np.float64]


class Tracking(enum.Enum):
    """How far the odometry is to be believed."""

    TRACKING = "tracking"
    DEGENERATE = "degenerate"
    """One direction is not seen; the motion prior holds there."""
    LOST = "lost"


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryConfig:
    """The odometry and its parts; lengths in metres, angles in radians."""

    reference: Literal["local_map", "key_scan", "previous_scan"] = "local_map"
    """What a scan is matched against; the paper's is the previous scan."""
    reference_points: Literal["all", "resampled"] = "all"
    """What of a scan goes into the reference: every point, or the means that are matched."""
    fill_m: float = 4.0
    """Greatest gap between two rays on one straight wall that is filled in the reference; 0 for none."""
    walls_have_sides: bool = True
    """Whether walls that the laser would see from behind are left out of the local map."""
    walls_tell_across: bool = True
    """Whether a point of a straight wall tells across it only; else a corner beside the laser holds it."""
    walkers_left_out: bool = True
    """Whether small things that walk, or may, are not trusted along directions that no wall sees."""
    key_scans: int = 40
    """Number of the newest key scans in the local map."""
    key_distance_m: float = 0.2
    key_angle_rad: float = 0.175
    """A scan this far from the last key scan becomes one."""
    deskew: bool = True
    """Whether each point is put where the laser was when it saw it: the sweep of a moving laser is bent."""
    resampling: ResamplingConfig = field(default_factory=ResamplingConfig)
    ndt: NdtConfig = field(default_factory=NdtConfig)
    matching: MatchingConfig = field(default_factory=MatchingConfig)
    prediction: PredictionConfig = field(default_factory=PredictionConfig)

    def __post_init__(self) -> None:
        if self.reference not in ("local_map", "key_scan", "previous_scan"):
            raise ValueError(
                f"reference = {self.reference!r}, must be 'local_map', 'key_scan' or 'previous_scan'"
            )
        if self.reference_points not in ("all", "resampled"):
            raise ValueError(f"reference_points = {self.reference_points!r}, must be 'all' or 'resampled'")
        if not 0.0 <= self.fill_m <= 20.0:
            raise ValueError(f"fill_m = {self.fill_m}, must be in [0, 20]")
        if not 1 <= self.key_scans <= 10_000:
            raise ValueError(f"key_scans = {self.key_scans}, must be in [1, 10000]")
        if not 0.0 < self.key_distance_m <= 10.0:
            raise ValueError(f"key_distance_m = {self.key_distance_m}, must be in (0, 10]")
        if not 0.0 < self.key_angle_rad <= np.pi:
            raise ValueError(f"key_angle_rad = {self.key_angle_rad}, must be in (0, pi]")


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """What one scan told."""

    motion: Motion
    state: Tracking
    """LOST when no scan has fitted for 0.4 s; until then a scan that does not fit has a lost motion only."""
    blind_rad: float | None
    """Direction, laser frame, in which the scan says nothing; None if there is none."""
    score: float
    """Mean point score, 0 to 1."""
    points_laser: Points
    """(M, 2) the points that were matched, as seen from the first ray."""
    key: bool
    """Whether the scan became part of the local map."""
    evaluations: int
    """Poses that the search tried."""


class LaserOdometry:
    """Follows the laser from scan to scan."""

    def __init__(self, config: OdometryConfig, seed: int = 0) -> None:
        self.config = config
        self._beams: Beams | None = None
        self._matcher = Matcher(config.matching, seed)
        self._filter = ConstantVelocity(config.prediction)
        many = config.reference == "local_map"
        self._local = LocalMap(config.ndt, config.key_scans if many else 1, many and config.walls_have_sides)
        fine_share = config.matching.fine_share if config.matching.polish else 0.0
        self._footing = Footing(self._matcher, many and config.walkers_left_out)
        self._walls = many and config.walls_tell_across
        self._straightener = Straightener(config.matching, self._walls)
        self._is_straightened = many and config.deskew
        self._certainty = Certainty(config.matching.score_weight, fine_share)
        self._blindness = Blindness()
        self._last_seen: tuple[Pose, float] | None = None
        """Where the last scan was, and how far it may be off, m, if it saw every direction by what stands."""

    def step(self, scan: Scan, missed: int = 0) -> Match:
        """Match the next scan.

        Args:
            scan: What the laser sees now.
            missed: How many scans before this one never came; stamps jitter and do not tell.

        Raises:
            ValueError: it has other beams than the first.
        """
        resampler, middle_s, watch = self._prepare(scan)
        duration_s = (1 + missed) * scan.beams.period_s
        prior = watch.expect(self._filter, duration_s) if self._local.keys else None
        twist = self._filter.twist if self.config.deskew else np.zeros(3)
        ends = resampler.points(scan, twist, middle_s)
        resampler.noise_m = self._certainty.noise.ray_m
        points = resampler.oriented_means(self._walls)
        if prior is not None:
            taken = self._filter.twist if self._footing.firm else self._steady()
            spans_m = resampler.spans_m(len(points))
            points = self._footing.leave_out(points, spans_m, float(prior.pose[2]), taken, duration_s)
        matching, fits, unseen = None, False, np.zeros((0, 2))
        covariance = self._filter.covariance[:3, :3]
        sees = len(points) > 0 and not shaded(points)
        if prior is not None and sees:
            self._local.face(prior.pose)
            matching = self._match(points, prior)
            if self._is_bent(scan, matching, resampler, middle_s):
                prior = self._filter.prior()
                ends = resampler.points(scan, self._filter.twist, middle_s)
                points = self._footing.trust(resampler.oriented_means(self._walls))
                matching = self._match(points, prior)
            matching, fits = self._locate(points, matching, prior, watch)
        if prior is not None and not fits:
            watch.miss(self._filter, missed)
        if prior is not None and matching is not None and (watch.trying or not watch.lost):
            # One that does not fit may still tell a little, as long as it is not known to be wrong.
            before = self._filter.twist
            unseen = self._correct(points, matching, prior, fits, duration_s)
            covariance = self._certainty.judge(
                scan,
                len(ends),
                points,
                matching,
                self._local.reference,
                (before, self._filter.twist),
                middle_s,
            )
        else:
            self._last_seen = None
        anew = sees and (prior is None or watch.hopeless)
        if anew:
            watch.begin()
            self._local.clear()
            self._filter.forget_velocity()
            self._cruise.forget()
            self._last_seen = (self._filter.pose.copy(), 0.0)
            self._footing.forget()
        if anew or fits:
            watch.remember(transform(self._filter.pose, ends))
        key = anew or (fits and not watch.doubtful and self._is_key())
        if key:
            # The match has told the velocity better than what the sweep was set right by.
            resampler.points(scan, self._filter.twist if self.config.deskew else np.zeros(3), middle_s)
            whole = self.config.reference_points == "all"
            seen = resampler.filled(self.config.fill_m) if whole else (points[:, :2], points[:, 2:])
            self._local.add(self._filter.pose, *seen)
        return Match(
            motion=self._motion(scan, middle_s, covariance, unseen, fits, anew),
            state=Tracking.LOST if watch.lost or not self._local.keys else _state(unseen),
            blind_rad=_axis(unseen),
            score=0.0 if matching is None else matching.score,
            points_laser=transform(exponential(self._filter.twist * middle_s), points[:, :2]),
            key=key,
            evaluations=0 if matching is None else matching.evaluations,
        )

    def _correct(
        self, points: Oriented, matching: Matching, prior: Prior, fits: bool, duration_s: float
    ) -> Points:
        """Take the match into the filter, where it sees; elsewhere the laser goes on as it did.

        Args:
            points: (N, 4) that were matched.
            matching: Of them, which need not fit.
            prior: Where the scan was expected.
            fits: Whether the scan fits there.
            duration_s: Since the scan before.

        Returns:
            (K, 2) unit vectors of the directions that are not seen, laser frame.
        """
        limit_m = blind_m(self._filter.drift_m(duration_s))
        seen = self._footing.learn(points, matching, self._local.reference, prior.pose, limit_m)
        pose = seen.hold(matching.pose, prior.pose)
        information = turned(seen.information, -pose[2])
        if self._watch.doubtful:
            information = weakened(information, prior, pose)
        self._filter.correct(pose, information, self._telling_s(points, matching) if fits else None)
        unseen = _in_laser(seen.unseen, pose[2])
        if len(unseen):
            velocity = self._steady()
            self._filter.bound(unseen, self._cruise.steady_s > 0.0)
            self._filter.steer(unseen, velocity)
        if fits and self._footing.firm and not self._watch.doubtful:
            self._learn_velocity(deviation_m(matching.information), duration_s)
        else:
            self._last_seen = None
        return unseen

    def _learn_velocity(self, off_m: float, duration_s: float) -> None:
        """Take in the motion to a scan that saw every direction by what stands, if the one before did, too.

        The first motion that is seen again takes back what was wrong before: it is no velocity.

        Args:
            off_m: How far this scan may be off in the direction that it sees worst.
            duration_s: Since the scan before.
        """
        pose = self._filter.pose.copy()
        if self._last_seen is not None:
            motion, ends_m = between(self._last_seen[0], pose), max(off_m, self._last_seen[1])
            self._cruise.see(motion, duration_s, ends_m)
            self._footing.believe(self._filter.twist)
        self._last_seen = (pose, off_m)

    def _telling_s(self, points: Oriented, matching: Matching) -> Matrix | None:
        """Return when the points (N, 4) of a slow sweep that tell were seen, on the laser's axes."""
        beams = self._resampler.beams
        if not (self.config.deskew and beams.sweep_s > SLOW_SHARE * beams.period_s):
            return None
        swept_rad = np.arctan2(points[:, 1], points[:, 0]) - beams.angle_min_rad
        swept_rad = np.mod(np.sign(beams.angle_increment_rad) * swept_rad, 2.0 * np.pi)
        seen_s = swept_rad / abs(beams.angle_increment_rad) * beams.time_increment_s - 0.5 * beams.sweep_s
        told_s = self._matcher.telling_s(points, seen_s, self._local.reference, matching)
        return turned(told_s, -matching.pose[2])

    def _match(self, points: Oriented, prior: Prior) -> Matching:
        # Whoever set out unseen may be farther away than any robot goes from scan to scan.
        reach = self._matcher.reach(prior) if self.config.reference == "local_map" else None
        return self._matcher.match(points, self._local.reference, prior, reach)

    def _steady(self) -> NDArray[np.float64]:
        """Return the velocity (2,), laser frame, that the laser has had, as far as walls told."""
        twist = self._footing.sure_twist(self._filter.twist)
        return self._cruise.velocity(twist, self._filter.doubt_m_s, float(self._filter.twist[2]))

    def _is_bent(self, scan: Scan, matching: Matching, resampler: Resampler, middle_s: float) -> bool:
        """Whether a scan fits badly because the laser began to turn; the filter knows the rate then."""
        least = self._watch.straight_score(matching)
        if least is None or not (self._is_straightened and self._footing.firm):
            return False
        reference = self._local.reference
        return self._straightener.straighten(scan, resampler, self._filter, middle_s, reference, least)

    def _locate(
        self, points: Oriented, matching: Matching, prior: Prior, watch: Watch
    ) -> tuple[Matching, bool]:
        """Judge the match of a scan where it is expected; where it does not fit there, look farther.

        Returns:
            The best match, and whether the scan fits there.
        """
        local = self._local
        if self.config.reference == "previous_scan":
            # The paper's chain takes every match.
            watch.take(matching)
            return matching, True
        if watch.accept(points, matching, prior, local.keys):
            return matching, True
        followed = watch.follow(points, prior, self._matcher, local.reference)
        if followed is not None:
            return followed, True
        # It may be anywhere, and see any side.
        local.show_all()
        return watch.find(points, matching, self._filter, self._matcher, local.reference, local.keys)

    def _prepare(self, scan: Scan) -> tuple[Resampler, float, Watch]:
        """Learn the beams from the first scan, and hold every other scan to them."""
        if self._beams is None:
            self._beams = scan.beams
            self._resampler = Resampler(self.config.resampling, scan.beams)
            self._watch = Watch(scan.beams.period_s, self.config.ndt)
            self._cruise = Cruise(scan.beams.period_s)
        elif scan.beams.count != self._beams.count:
            raise ValueError(
                f"scan of {scan.beams.count} beams, must be {self._beams.count} as the first scan"
            )
        return self._resampler, 0.5 * scan.beams.sweep_s if self.config.deskew else 0.0, self._watch

    def _is_key(self) -> bool:
        if not self._local.keys or self.config.reference == "previous_scan":
            return True
        moved = between(self._local.keys[-1].odom_t_laser, self._filter.pose)
        return bool(
            np.hypot(moved[0], moved[1]) >= self.config.key_distance_m
            or abs(moved[2]) >= self.config.key_angle_rad
        )

    def _motion(
        self, scan: Scan, middle_s: float, covariance: Matrix, unseen: Points, fits: bool, anew: bool
    ) -> Motion:
        if anew or self._watch.elsewhere:
            covariance = anew_covariance()
        elif not fits:
            covariance = lost_covariance()
        elif self._watch.doubtful:
            covariance = doubted_covariance()
        else:
            if self._watch.shaken:
                covariance = covariance + np.diag(SHAKEN**2)
            covariance = self._blindness.widened(
                covariance, unseen, self._watch.since_s, self._cruise.steady_s
            )
        return Motion(
            stamp_ns=scan.stamp_ns,
            odom_t_laser=snap_yaw(compose(self._filter.pose, exponential(-self._filter.twist * middle_s))),
            covariance=covariance,
            twist=self._filter.twist.copy(),
        )


def _state(unseen: Points) -> Tracking:
    return Tracking.DEGENERATE if len(unseen) else Tracking.TRACKING


def _in_laser(directions: Points, yaw_rad: float) -> Points:
    """Turn unit vectors (K, 2) of the odometry's axes into the laser's."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return directions @ np.array(((c, -s), (s, c)))


def _axis(unseen: Points) -> float | None:
    """Return the angle of the first unseen direction, laser frame, in (-pi/2, pi/2]; None if all is seen."""
    if len(unseen) == 0:
        return None
    angle = float(np.arctan2(unseen[0, 1], unseen[0, 0]))
    return float(np.pi / 2 - (np.pi / 2 - angle) % np.pi)
