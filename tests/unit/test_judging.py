"""Where a search finds the laser is believed for reasons: likely, alone, told apart, found again."""

import itertools

import numpy as np
import pytest

from drivers.world.generators import corridor, hallway_with_doors
from drivers.world.laser import Sick, bearings
from processing.dpslam.judging import PERSISTENT_M, Finding, Judge, away_m
from processing.dpslam.loop_config import LoopConfig
from processing.dpslam.settled import SettledMap
from processing.se2 import compose

PLACE = np.array((20.0, 1.2, 0.0))
LIKELY, UNLIKELY = np.diag((0.1**2, 0.1**2, 0.02**2)), np.diag((0.01**2, 0.01**2, 0.002**2))
LOST = np.diag((3.0**2, 3.0**2, 0.1**2))


def look(building, at, seed=0):
    """Points (N, 2) that a laser sees within 8 m."""
    laser = Sick()
    ranges_m = laser.measure(building, np.tile(at, (len(bearings(laser)), 1)), np.random.default_rng(seed))
    seen = np.isfinite(ranges_m) & (ranges_m < 8.0)
    directions = np.column_stack((np.cos(bearings(laser)), np.sin(bearings(laser))))
    return np.ascontiguousarray((ranges_m[:, None] * directions)[seen], dtype=np.float64)


def mapped(building):
    settled = SettledMap()
    for x in np.arange(5.0, 35.0, 0.5):
        at = np.array((x, 1.2, 0.0))
        settled.add(look(building, at), at)
    return settled


@pytest.fixture(scope="module")
def doors():
    building = hallway_with_doors()
    return building, mapped(building)


def finding(building, off=(0.0, 0.0, 0.0), rival=None, ratio=0.0, drift=LIKELY, way_m=100.0, score=0.9):
    """The laser was found at PLACE; the path has it `off` from there (3,), in its own frame."""
    return Finding(
        place=PLACE,
        rival=None if rival is None else compose(PLACE, np.array(rival)),
        score=score,
        rival_ratio=ratio,
        at=compose(PLACE, np.array(off)),
        drift=drift,
        points=look(building, PLACE, 7),
        way_m=way_m,
    )


def test_a_likely_place_without_a_rival_is_believed_at_once(doors):
    building, settled = doors
    assert Judge(LoopConfig()).believes(finding(building), settled)


def test_a_drift_of_many_sigmas_is_believed_only_if_it_fits_well(doors):
    building, settled = doors
    off = (0.035, 0.0, 0.0)
    drift = np.diag((0.005**2, 0.005**2, 0.002**2))
    verdicts = [
        Judge(LoopConfig()).believes(finding(building, (0.15, 0.0, 0.0), drift=drift, score=score), settled)
        for score in (0.7, 0.99)
    ]
    assert verdicts == [False, True]
    assert Judge(LoopConfig()).believes(finding(building, off, drift=drift, score=0.7), settled)


def test_where_the_path_may_be_far_off_a_place_must_be_found_twice(doors):
    building, settled = doors
    judge = Judge(LoopConfig())
    first = finding(building, drift=LOST)
    assert not judge.believes(first, settled)
    assert judge.waits
    # The next search may have begun several metres farther on.
    assert judge.believes(finding(building, drift=LOST, way_m=110.0), settled)
    again = Judge(LoopConfig())
    assert not again.believes(first, settled)
    assert not again.believes(finding(building, drift=LOST, way_m=113.0), settled)
    other = Judge(LoopConfig())
    assert not other.believes(first, settled)
    assert not other.believes(finding(building, off=(1.0, 0.0, 0.0), drift=LOST, way_m=102.0), settled)


def test_a_rival_along_the_corridor_is_told_apart_by_doors_and_only_by_them(doors):
    plain = corridor(40.0, 2.4)
    for (building, settled), believed in ((doors, True), ((plain, mapped(plain)), False)):
        judge = Judge(LoopConfig())
        found = [
            judge.believes(
                finding(building, rival=(1.5, 0.0, 0.0), ratio=0.96, drift=LOST, way_m=way_m), settled
            )
            for way_m in (100.0, 105.0)
        ]
        assert found == [False, believed]


def test_of_two_places_that_fit_equally_none_is_believed(doors):
    building, settled = doors
    judge = Judge(LoopConfig())
    same = [finding(building, rival=(0.0, 0.0, 0.0), ratio=0.96, drift=LOST, way_m=w) for w in (100.0, 105.0)]
    assert [judge.believes(one, settled) for one in same] == [False, False]


@pytest.mark.parametrize(("way_m", "believed"), [(0.4 * PERSISTENT_M, False), (1.1 * PERSISTENT_M, True)])
def test_an_odd_drift_is_believed_when_it_stays_the_same_for_long(doors, way_m, believed):
    building, settled = doors
    judge = Judge(LoopConfig())
    steps = np.linspace(100.0, 100.0 + way_m, 6)
    verdicts = [
        judge.believes(finding(building, (1.5, 0.6, 0.0), drift=UNLIKELY, way_m=w), settled) for w in steps
    ]
    assert verdicts == [False] * 5 + [believed]


def test_odd_drifts_that_differ_from_one_another_are_none(doors):
    building, settled = doors
    judge = Judge(LoopConfig())
    offs = itertools.cycle(((1.5, 0.6, 0.0), (2.5, -0.6, 0.0)))
    steps = np.linspace(100.0, 100.0 + 3.0 * PERSISTENT_M, 8)
    verdicts = [
        judge.believes(finding(building, off, drift=UNLIKELY, way_m=w), settled)
        for off, w in zip(offs, steps, strict=False)
    ]
    assert not any(verdicts)


@pytest.mark.parametrize("drift", [LOST, UNLIKELY])
def test_restored_it_waits_for_the_same(doors, drift):
    building, settled = doors
    judge = Judge(LoopConfig())
    off = (1.5, 0.6, 0.0) if drift is UNLIKELY else (0.0, 0.0, 0.0)
    assert not judge.believes(finding(building, off, drift=drift), settled)
    again = Judge(LoopConfig())
    np.testing.assert_array_equal(again.state(), Judge(LoopConfig()).state())
    again.restore(judge.state())
    np.testing.assert_array_equal(again.state(), judge.state())
    later = finding(
        building, off, drift=drift, way_m=100.0 + (1.1 * PERSISTENT_M if drift is UNLIKELY else 5.0)
    )
    assert again.believes(later, settled)
    again.forget()
    assert not again.waits
    assert not again.believes(later, settled)


def test_how_far_off_is_that_of_the_worst_direction():
    along = np.array((0.6, 0.8))
    drift = np.diag((0.1**2, 0.1**2, 1.0))
    drift[:2, :2] += (2.0**2 - 0.1**2) * np.outer(along, along)
    assert away_m(drift) == pytest.approx(2.0)
