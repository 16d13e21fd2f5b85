"""Who is left out of a scan, and when."""

import numpy as np
import pytest

from processing.footing import LEAST_POINTS, SURE_SCANS, WALKING_M_S, Footing
from processing.matching import Matcher, MatchingConfig
from processing.ndt import Ndt, NdtConfig
from processing.prediction import Prior

PERIOD_S = 0.1
DRIVES = np.array((0.4, 0.0, 0.0))
ALONG_M = np.arange(-3.95, 4.0, 0.1)
WALLS = np.vstack([np.column_stack((ALONG_M, np.full(len(ALONG_M), y))) for y in (-1.03, 1.07)])
LEGS = np.array(((0.0, -0.1), (0.02, 0.0), (0.0, 0.1), (0.05, 0.05)))


def corridor():
    """Plain walls; scans are matched where the laser is expected."""
    reference = Ndt(NdtConfig())
    reference.build(WALLS)
    return reference


def drive(person_m_s, twist=DRIVES, scans=25, walkers=True):
    """Footing after a drive along a corridor, and how many points each scan kept of who walks there."""
    matcher, reference = Matcher(MatchingConfig(), 1), corridor()
    footing, kept = Footing(matcher, walkers), []
    for _ in range(SURE_SCANS):
        footing.believe(twist)
    spans = np.concatenate((np.full(len(WALLS), 8.0), np.full(len(LEGS), 0.2)))
    for k in range(scans):
        at = np.array((2.0 + PERIOD_S * k * (person_m_s - twist[0]), 0.2))
        points = footing.leave_out(np.vstack((WALLS, LEGS + at)), spans, 0.0, twist, PERIOD_S)
        kept.append(len(points) - len(WALLS))
        matching = matcher.match(points, reference, Prior(np.zeros(3), 1e8 * np.eye(3)))
        footing.learn(points, matching, reference, np.zeros(3), 0.03)
    return footing, kept


def test_in_a_corridor_somebody_new_is_not_asked_and_who_walks_is_never():
    footing, kept = drive(-0.8)
    assert not footing.firm
    np.testing.assert_allclose(np.abs(footing.sight.leaning), ((1.0, 0.0),), atol=0.02)
    # The first scan is the one that tells that walls do not see.
    assert kept[0] == len(LEGS)
    assert set(kept[1:]) == {0}


def test_what_stands_is_asked_after_a_while():
    _, kept = drive(0.0)
    assert set(kept[1:4]) == {0}
    assert kept[-1] == len(LEGS)


def test_a_laser_as_fast_as_people_walk_leaves_nobody_out():
    assert set(drive(-0.8, np.array((WALKING_M_S + 0.1, 0.0, 0.0)))[1]) == {len(LEGS)}


def test_nobody_is_left_out_who_is_not_looked_for():
    assert set(drive(-0.8, walkers=False)[1]) == {len(LEGS)}


def test_a_scan_of_nothing_but_people_is_left_as_it_is():
    footing, _ = drive(-0.8)
    few = LEGS[: LEAST_POINTS - 1]
    assert len(footing.leave_out(few, np.full(len(few), 0.2), 0.0, DRIVES, PERIOD_S)) == len(few)


def test_the_velocity_is_the_middle_one_of_the_last_that_were_seen():
    footing = Footing(Matcher(MatchingConfig(), 1), True)
    np.testing.assert_array_equal(footing.sure_twist(DRIVES), DRIVES)
    for speed in (9.0, 0.3, 0.4, 0.5, -5.0, 0.4):
        footing.believe(np.array((speed, 0.0, 0.0)))
    assert footing.sure_twist(DRIVES)[0] == pytest.approx(0.4)
    footing.forget()
    np.testing.assert_array_equal(footing.sure_twist(DRIVES), DRIVES)
    assert footing.firm


def test_many_small_things_cannot_all_walk_the_same_way():
    matcher, rng = Matcher(MatchingConfig(), 1), np.random.default_rng(1)
    chairs = np.vstack([LEGS + at for at in ((-3.0, 0.1), (-1.5, -0.3), (0.4, 0.3), (1.9, -0.2), (3.3, 0.2))])
    points = np.vstack((WALLS, chairs))
    reference = Ndt(NdtConfig())
    reference.build(np.vstack([points + rng.normal(0.0, 0.01, points.shape) for _ in range(10)]))
    spans = np.concatenate((np.full(len(WALLS), 8.0), np.full(len(chairs), 0.2)))
    footing = Footing(matcher, True)
    left = footing.leave_out(points, spans, 0.0, DRIVES, PERIOD_S)
    matching = matcher.match(left, reference, Prior(np.zeros(3), 1e8 * np.eye(3)))
    footing.learn(left, matching, reference, np.zeros(3), 0.03)
    assert footing.firm


@pytest.mark.parametrize(("expected_m", "seen"), [(0.0, False), (1.0, True)])
def test_where_it_cannot_be_is_seen_even_if_where_it_is_is_seen_vaguely(expected_m, seen):
    # Each point tells across its wall only, so that nothing tells along; doors are a little deeper.
    matcher, doors = Matcher(MatchingConfig(), 1), (np.abs(ALONG_M) % 2.0 < 0.7) * 0.15
    sides = [np.column_stack((ALONG_M, sign * (1.05 + doors))) for sign in (-1.0, 1.0)]
    reference = Ndt(NdtConfig())
    reference.build(np.vstack(sides))
    walls = np.vstack(
        [np.hstack((side, np.tile((0.0, -np.sign(side[0, 1])), (len(side), 1)))) for side in sides]
    )
    matching = matcher.match(walls, reference, Prior(np.zeros(3), 1e8 * np.eye(3)))
    footing = Footing(matcher, True)
    footing.leave_out(walls, np.full(len(walls), 8.0), 0.0, DRIVES, PERIOD_S)
    view = footing.learn(walls, matching, reference, np.array((expected_m, 0.0, 0.0)), 0.015)
    assert (len(view.unseen) == 0) == seen
