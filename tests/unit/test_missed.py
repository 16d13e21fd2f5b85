"""How many scans never came: by the numbers of the laser, or by the stamps where there are none to go by."""

import numpy as np
import pytest

from runtime.formats.stamp_holes import HOLE_S, StampHoles, missing_before
from runtime.nodes.missed import Missed

S = 10**9
PERIOD_S = 0.1
LONG = round(HOLE_S / PERIOD_S)


def counts(*scans):
    """Show (publisher, number, second) of scans that come ten times a second."""
    missed = Missed()
    return [missed.before(publisher, number, round(at_s * S), PERIOD_S) for publisher, number, at_s in scans]


@pytest.mark.parametrize(
    ("scans", "expected"),
    [
        ([("a", 7, 1.0), ("a", 8, 1.1), ("a", 11, 1.2)], [0, 0, 2]),  # stamps jitter; numbers do not
        ([("a", 7, 1.0), ("b", 1, 2.3), ("b", 2, 2.4)], [0, 12, 0]),  # another process, 1.3 s later
        ([("a", 7, 1.0), ("b", 40, 1.1)], [0, 0]),  # whose numbers say nothing of the first one's
        ([("a", -1, 1.0), ("a", -1, 1.3)], [0, 2]),  # no numbers
        ([("a", 7, 1.0), ("a", 7, 1.0), ("a", 6, 0.9)], [0, 0, 0]),  # again, and out of order
        ([("a", 1, 1.0), ("a", 5000, 500.0)], [0, LONG]),
    ],
)
def test_what_never_came_is_counted(scans, expected):
    assert counts(*scans) == expected


@pytest.mark.parametrize(
    ("periods", "expected"),
    [
        ([0, 1, 2, 5, 6, 7], [0, 0, 0, 2, 0, 0]),
        ([0, 1, 4, 4.1, 4.2, 5], [0, 0, 0, 0, 0, 0]),  # held up, and then in a burst
        ([0, 1, 4, 2.9, 4, 5], [0, 0, 0, 0, 0, 0]),  # one stamp before its time
        ([0, 1.4, 1.7, 3.3, 3.9, 5.2], [0, 0, 0, 0, 0, 0]),  # jitter
        ([0, 1, 3, 4, 9, 10], [0, 0, 1, 0, 4, 0]),
        ([0, 1, 2, 1000, 1001], [0, 0, 0, LONG, 0]),
        ([0, 1, 2, 1, 2, 3], [0, 0, 0, 0, 0, 0]),  # a clock set back
        ([7], [0]),
        ([], []),
    ],
)
def test_in_a_log_without_numbers_the_stamps_around_a_hole_agree_on_it(periods, expected):
    stamps_ns = np.array([round((100.0 + PERIOD_S * at) * S) for at in periods], np.int64)
    assert missing_before(stamps_ns, PERIOD_S).tolist() == expected
    assert while_they_come(stamps_ns) == expected


def test_what_is_counted_while_scans_come_is_what_the_whole_log_tells():
    rng = np.random.default_rng(5)
    for _ in range(20):
        number = np.cumsum(rng.choice([1, 1, 1, 1, 1, 1, 1, 1, 3, 60], 200))
        held_up = rng.choice([0.0, 0.0, 0.0, 0.4, 3.0], 200) * rng.random(200)
        stamps_ns = np.round((number + held_up) * PERIOD_S * S).astype(np.int64)
        expected = missing_before(stamps_ns, PERIOD_S).tolist()
        assert sum(expected) > 0
        assert while_they_come(stamps_ns) == expected


def while_they_come(stamps_ns):
    holes = StampHoles(PERIOD_S)
    counts = [count for stamp in stamps_ns.tolist() if (count := holes.take(stamp)) is not None]
    return [*counts, *holes.end()]
