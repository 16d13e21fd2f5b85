"""Who walks and what stands: told by how things pass the laser."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from processing import walker_kernels as w
from processing.walker_kernels import APART_M, FAR_M, LATCH_S, SMALL_M, WATCH_S
from processing.walkers import Kind, Walkers

PERIOD_S = 0.1
DRIVES = np.array((0.4, 0.0))
ALONG = np.array(((1.0, 0.0),))
SEEN = np.zeros((0, 2))
NOISE_M = 0.01


def pass_by(ways, *, unseen=ALONG, velocity=DRIVES, yaw_rad=0.0, seed=0):
    """Return the kind of a thing after each scan, as it goes along `ways` (N, 2); NaN hides it."""
    rng = np.random.default_rng(seed)
    walkers, kinds = Walkers(), []
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array(((c, -s), (s, c)))
    for at in ways:
        points = at + np.array(((0.0, -0.05), (0.0, 0.0), (0.0, 0.05))) + rng.normal(0.0, NOISE_M, (3, 2))
        points = points[np.isfinite(at).all()].reshape(-1, 2)
        seen = walkers.look(
            points, np.full(len(points), 0.1), yaw_rad, turn @ velocity, 0.4, unseen @ turn.T, PERIOD_S
        )
        kinds.append(Kind(seen[0]) if len(seen) else None)
        assert (seen == seen[:1]).all()
    return kinds


def way(count, speed_m_s, start=(3.0, 0.5)):
    """Places relative to a laser at DRIVES of something that goes ahead at a speed, one a scan."""
    times = PERIOD_S * np.arange(count)[:, None]
    return np.array(start) + times * (np.array((speed_m_s, 0.0)) - DRIVES)


@pytest.mark.parametrize("yaw_rad", [0.0, 2.0])
@pytest.mark.parametrize("unseen", [ALONG, SEEN], ids=["unseen", "seen"])
def test_what_stands_is_known_to_stand_after_half_a_second(unseen, yaw_rad):
    kinds = pass_by(way(40, 0.0), unseen=unseen, yaw_rad=yaw_rad)
    watched = round(WATCH_S / PERIOD_S)
    assert set(kinds[:watched]) == {Kind.NEW}
    assert set(kinds[watched + 3 :]) == {Kind.STANDS}


@pytest.mark.parametrize("yaw_rad", [0.0, 2.0])
@pytest.mark.parametrize("unseen", [ALONG, SEEN], ids=["unseen", "seen"])
@pytest.mark.parametrize("speed_m_s", [-1.2, -0.7, 0.8, 1.3])
def test_who_walks_is_known_to_walk(speed_m_s, unseen, yaw_rad):
    kinds = pass_by(way(25, speed_m_s), unseen=unseen, yaw_rad=yaw_rad)
    assert Kind.STANDS not in kinds
    assert set(kinds[10:]) == {Kind.WALKS}


@pytest.mark.parametrize("actual_m_s", [0.0, 0.2, 0.5])
def test_a_laser_that_changed_its_speed_unseen_is_believed(actual_m_s):
    # It is taken to drive on as it did; what stands passes it as it drives now.
    passing = way(30, 0.0) + PERIOD_S * np.arange(30)[:, None] * (DRIVES - (actual_m_s, 0.0))
    assert set(pass_by(passing)[10:]) == {Kind.STANDS}


def test_where_walls_see_a_slow_drift_of_a_thing_is_no_walk():
    assert set(pass_by(way(30, 0.3), unseen=SEEN)[10:]) == {Kind.STANDS}


def test_across_a_corridor_a_step_is_a_step_whatever_is_unseen_along():
    times = PERIOD_S * np.arange(25)[:, None]
    ways = np.array((3.0, -1.0)) + times * (np.array((0.0, 0.8)) - DRIVES)
    assert set(pass_by(ways)[10:]) == {Kind.WALKS}


def test_a_walker_who_was_hidden_for_a_moment_is_still_one():
    ways = way(30, 1.0)
    ways[15:20] = np.nan
    kinds = pass_by(ways)
    assert kinds[14] is Kind.WALKS
    assert set(kinds[15:20]) == {None}
    assert set(kinds[20:]) == {Kind.WALKS}


def test_hidden_for_long_he_is_somebody_new():
    ways = way(45, 0.9, start=(1.0, 0.5))
    ways[12:30] = np.nan
    kinds = pass_by(ways)
    assert kinds[11] is Kind.WALKS
    assert kinds[30] is Kind.NEW


def test_who_stops_is_believed_after_a_while_only():
    walk = way(20, 1.0)
    stop = walk[-1] - PERIOD_S * np.arange(1, 60)[:, None] * DRIVES
    kinds = pass_by(np.vstack((walk, stop)))
    first = kinds.index(Kind.STANDS)
    assert set(kinds[10:first]) == {Kind.WALKS}
    assert first >= 20 + round(LATCH_S / PERIOD_S)
    assert set(kinds[first:]) == {Kind.STANDS}


def test_two_who_meet_keep_who_they_are():
    walkers = Walkers()
    pillar, walker = way(30, 0.0, start=(2.5, 0.5)), way(30, -1.0, start=(5.0, -0.4))
    for k in range(30):
        points = np.array((pillar[k], walker[k]))
        kinds = walkers.look(points, np.full(2, 0.1), 0.0, DRIVES, 0.4, ALONG, PERIOD_S)
        if k > 10:
            assert kinds.tolist() == [Kind.STANDS, Kind.WALKS]


def test_a_leg_that_comes_out_from_behind_the_other_walks_as_it_does():
    walkers = Walkers()
    leg = way(25, -0.9, start=(5.0, 0.5))
    for k in range(24):
        walkers.look(leg[k : k + 1], np.full(1, 0.1), 0.0, DRIVES, 0.4, ALONG, PERIOD_S)
    # Its surface ends too far from the other's to be one thing with it.
    two = np.vstack((leg[24], leg[24] + (APART_M + 0.02, 0.0)))
    apart = two + np.array(((0.05, 0.0), (0.0, 0.0)))
    assert walkers.look(two, np.full(2, 0.1), 0.0, DRIVES, 0.4, ALONG, PERIOD_S).tolist() == [
        Kind.WALKS,
        Kind.NEW,
    ]
    walkers.look(leg[24:], np.full(1, 0.1), 0.0, DRIVES, 0.4, ALONG, PERIOD_S)
    near = np.vstack((apart[0], apart[0] + (0.45, 0.0), apart[0] + (0.3, 0.6)))
    kinds = walkers.look(near, np.full(3, 0.1), 0.0, DRIVES, 0.4, ALONG, PERIOD_S)
    assert kinds.tolist() == [Kind.WALKS, Kind.WALKS, Kind.NEW]


def test_a_speed_between_what_stands_and_what_walks_is_no_verdict():
    # A little faster than the laser can have become, and not clearly.
    passing = way(30, 0.0) - PERIOD_S * np.arange(30)[:, None] * np.array((0.27, 0.0))
    rough = np.random.default_rng(5).normal(0.0, 0.04, passing.shape)
    assert set(pass_by(passing + rough)[:14]) == {Kind.NEW}


def test_walls_are_walls_and_legs_are_one_thing():
    legs = np.array(((2.0, 0.2), (2.2, -0.1), (2.25, -0.1)))
    chair = np.array(((2.0, 0.2 + APART_M + 0.1),))
    wall = np.column_stack((np.linspace(0.0, 2.0, 5), np.full(5, 1.0)))
    far = np.array(((FAR_M + 0.1, 0.0),))
    spans = np.array((0.1,) * 4 + (2.0 * SMALL_M,) * 5 + (0.1,))
    points, numbers = np.vstack((legs, chair, wall, far)), np.empty(10, np.int64)
    assert w.things_of(points, spans, numbers) == 2
    assert numbers.tolist() == [0, 0, 0, 1, *[-1] * 6]
    kinds = Walkers().look(wall, np.full(5, 2.0), 0.0, DRIVES, 0.4, SEEN, PERIOD_S)
    assert kinds.tolist() == [Kind.WALL] * 5


def plainly_things_of(points, spans_m):
    """The same, as one would write it first."""
    numbers = [-1] * len(points)
    small = [k for k in range(len(points)) if spans_m[k] < SMALL_M and np.hypot(*points[k]) < FAR_M]
    count = 0
    for k in small:
        if numbers[k] >= 0:
            continue
        reached = [k]
        while reached:
            a = reached.pop()
            numbers[a] = count
            reached += [b for b in small if numbers[b] < 0 and np.hypot(*(points[b] - points[a])) < APART_M]
        count += 1
    groups = [[points[k] for k in small if numbers[k] == n] for n in range(count)]
    kept = [n for n in range(count) if np.hypot(*np.ptp(groups[n], axis=0)) < SMALL_M]
    return [kept.index(n) if n in kept else -1 for n in numbers]


class PlainWalkers:
    """The same as `Walkers`, as one would write it first: each thing a dictionary with all its sights."""

    def __init__(self):
        self.things = []

    def look(self, points, spans_m, yaw_rad, velocity, fastest_m_s, unseen, duration_s):
        for thing in self.things:
            thing["at"] = thing["at"] + duration_s * (
                plain_speed(thing)[0] if thing["kind"] == Kind.WALKS else -velocity
            )
            thing["times"] = [t - duration_s for t in thing["times"]]
            thing["age"] += duration_s
            thing["hidden"] += duration_s
        numbers = np.array(plainly_things_of(points, spans_m), np.int64)
        c, s = np.cos(yaw_rad), np.sin(yaw_rad)
        places = [
            np.array(((c, -s), (s, c))) @ points[numbers == n].mean(axis=0)
            for n in range(numbers.max(initial=-1) + 1)
        ]
        old, same = self.things, self.who_is_who(places)
        self.things = []
        for n, at in enumerate(places):
            splits = any(t["kind"] == Kind.WALKS and np.hypot(*(t["at"] - at)) < w.STRIDE_M for t in old)
            stood, kind = (0.0, Kind.WALKS) if splits else (LATCH_S, Kind.NEW)
            new = {"times": [], "places": [], "age": 0.0, "stood": stood, "kind": kind}
            thing = dict(old[same[n]]) if n in same else new
            thing |= {"at": at, "hidden": 0.0, "times": [*thing["times"], 0.0]}
            thing["places"] = [*thing["places"], at]
            plainly_judge(thing, velocity, fastest_m_s, unseen, duration_s)
            self.things.append(thing)
        kinds = np.array([Kind.WALL if n < 0 else self.things[n]["kind"] for n in numbers], np.int64)
        self.things += [
            thing
            for j, thing in enumerate(old)
            if j not in same.values() and thing["kind"] == Kind.WALKS and thing["hidden"] < w.HIDDEN_S
        ]
        return kinds

    def who_is_who(self, places):
        """Which of the known things each place is: nearest pairs first."""
        pairs = []
        for n, at in enumerate(places):
            for j, thing in enumerate(self.things):
                stride = w.WALKERS_STRIDE_M if thing["kind"] == Kind.WALKS else w.STRIDE_M
                off = np.hypot(*(thing["at"] - at)) / stride
                if off < 1.0:
                    pairs.append((off, n, j))
        same = {}
        for _, n, j in sorted(pairs):
            if n not in same and j not in same.values():
                same[n] = j
        return same


def plain_speed(thing):
    """Weighted least squares, axis by axis."""
    times, places = np.array(thing["times"]), np.array(thing["places"])
    weights = np.exp(times / w.MEMORY_S)
    weights /= weights.sum()
    off = times - weights @ times
    spread = weights @ off**2
    if spread < 1e-9:
        return np.zeros(2), 0.0
    speed = (weights * off) @ places / spread
    rest = places - weights @ places - off[:, None] * speed
    return speed, np.sqrt(weights @ (rest**2).sum(axis=1) / (spread * np.exp(times / w.MEMORY_S).sum()))


def plainly_judge(thing, velocity, fastest_m_s, unseen, duration_s):
    speed, sigma = plain_speed(thing)
    laser, slack = -speed, 2.0 * sigma
    if thing["age"] < WATCH_S - 1e-6 or slack > w.SURE_M_S:
        return
    out = [0.0]
    rest = np.eye(2)
    for direction in unseen:
        usual, along = direction @ velocity, direction @ laser
        fast = max(w.FAST_M_S, w.FASTER * fastest_m_s) + w.ODD_M_S
        out += [(-fast if usual < w.ODD_M_S else -w.ODD_M_S) - along]
        out += [along - (fast if usual > -w.ODD_M_S else w.ODD_M_S)]
        rest = rest - np.outer(direction, direction)
    out += [np.hypot(*(rest @ (laser - velocity))) - w.WALKS_M_S]
    if max(out) > slack:
        thing |= {"stood": 0.0, "kind": Kind.WALKS}
    elif max(out) <= 0.0:
        thing["stood"] += duration_s
        if thing["stood"] >= LATCH_S:
            thing["kind"] = Kind.STANDS


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("unseen", [SEEN, ALONG, np.eye(2)], ids=["seen", "along", "blind"])
def test_the_compiled_look_is_the_plain_one(seed, unseen):
    rng = np.random.default_rng(seed)
    places, speeds = rng.uniform(-4.0, 4.0, (8, 2)), rng.normal(0.0, 0.7, (8, 2))
    speeds[::2] = 0.0
    compiled, plain, met = Walkers(), PlainWalkers(), set()
    for k in range(60):
        yaw_rad = 0.02 * k
        c, s = np.cos(yaw_rad), np.sin(yaw_rad)
        relative = places + PERIOD_S * k * (speeds - DRIVES) + rng.normal(0.0, 0.02, (8, 2))
        points = np.ascontiguousarray((relative @ np.array(((c, -s), (s, c))))[rng.random(8) < 0.9])
        spans = np.full(len(points), 0.2)
        arguments = (points, spans, yaw_rad, DRIVES, 0.4, unseen, PERIOD_S)
        kinds = compiled.look(*arguments)
        np.testing.assert_array_equal(kinds, plain.look(*arguments))
        met |= set(kinds.tolist())
    assert met >= {Kind.NEW, Kind.STANDS} or len(unseen) < 2
    assert Kind.WALKS in met


POINTS = arrays(
    np.float64, st.tuples(st.integers(0, 30), st.just(2)), elements=st.floats(-4.0, 4.0, width=16)
)


@given(points=POINTS, data=st.data())
def test_things_are_what_hangs_together(points, data):
    spans = data.draw(arrays(np.float64, len(points), elements=st.sampled_from((0.1, 0.9, 1.1, np.inf))))
    numbers = np.empty(len(points), np.int64)
    count = w.things_of(points, spans, numbers)
    assert numbers.tolist() == plainly_things_of(points, spans)
    assert count == numbers.max(initial=-1) + 1


@given(scans=st.lists(POINTS, max_size=15), yaw_rad=st.floats(-3.0, 3.0), unseen=st.integers(0, 2))
def test_whatever_is_seen_every_point_has_a_kind_and_nothing_breaks(scans, yaw_rad, unseen):
    walkers = Walkers()
    for points in scans:
        spans = np.full(len(points), 0.1)
        kinds = walkers.look(points, spans, yaw_rad, DRIVES, 0.4, np.eye(2)[:unseen], PERIOD_S)
        assert kinds.shape == (len(points),)
        assert set(kinds.tolist()) <= set(Kind)
        assert ((kinds == Kind.WALL) == (np.array(plainly_things_of(points, spans)) < 0)).all()
