"""A place on partly known ground is believed when it refutes the path, stands alone, and is found again."""

import numpy as np
import pytest

from processing.dpslam.judging import Finding
from processing.dpslam.loop_config import LoopConfig
from processing.dpslam.part_judge import KEPT_M, TIMES, PartJudge, disputed
from processing.se2 import compose

DRIFT = np.diag((0.5**2, 0.5**2, 0.1**2))
PLACE = np.array((3.0, -2.0, 0.5))
POINTS = 300


def fits(walls, passed):
    """So many points on walls, so many where rays have passed, the others where nothing is known."""
    return np.repeat((1.0, -1.0, 0.0), (walls, passed, POINTS - walls - passed))


GOOD = {"here": fits(60, 4), "there": fits(0, 0)[::-1] - np.repeat((1.0, 0.0), (50, POINTS - 50))}


def finding(way_m=100.0, off=(0.4, -0.5, 0.08), ratio=0.4, drift=DRIFT, rival=None):
    return Finding(
        place=PLACE,
        rival=None if rival is None else compose(PLACE, np.array(rival)),
        score=0.2,
        rival_ratio=ratio,
        at=compose(PLACE, np.array(off)),
        drift=drift,
        points=np.zeros((POINTS, 2)),
        way_m=way_m,
    )


def verdicts(looks, **fitting):
    judge = PartJudge(LoopConfig())
    told = {**GOOD, **fitting}
    return [judge.believes(look, told["here"], told["there"]) for look in looks]


def along(*ways_m, **settings):
    return [finding(100.0 + way_m, **settings) for way_m in ways_m]


def test_what_is_found_three_times_along_some_way_is_believed():
    assert verdicts(along(0.0, 1.0, 2.0)) == [False, False, True]
    # Three looks at the same metre of way are one.
    assert verdicts(along(0.0, 0.5, 1.0, 2.0)) == [False, False, False, True]
    assert TIMES == 3


def test_looks_that_disagree_or_lie_far_back_do_not_count():
    judge = PartJudge(LoopConfig())
    for k, off in enumerate(((0.4, -0.5, 0.08), (0.4, 0.2, 0.0), (0.4, -0.5, 0.08), (0.4, 0.2, 0.0))):
        assert not judge.believes(finding(100.0 + k, off=off), **GOOD)
    assert not any(verdicts(along(0.0, 1.0, KEPT_M + 1.5, KEPT_M + 3.0)))


@pytest.mark.parametrize(
    ("why", "settings", "fitting"),
    [
        ("too few points tell", {}, {"here": fits(29, 0)}),
        ("too many lie where rays passed", {}, {"here": fits(60, 21)}),
        ("the path fits as well", {}, {"there": GOOD["here"]}),
        ("nothing speaks against the path", {}, {"there": np.zeros(POINTS)}),
        ("another place is nearly as good", {"ratio": 0.86}, {}),
        ("another place is nearly as good, and turned", {"ratio": 0.86, "rival": (2.0, 0.0, 0.3)}, {}),
        ("nobody drifts so far", {"drift": DRIFT / 12.0}, {}),
    ],
)
def test_one_reason_is_enough_to_doubt(why, settings, fitting):
    assert verdicts(along(0.0, 1.0, 2.0)) == [False, False, True]
    assert not any(verdicts(along(0.0, 1.0, 2.0, 3.0, **settings), **fitting)), why


def test_a_rival_along_a_corridor_leaves_the_place_across_it():
    along_it = {"ratio": 0.95, "rival": (2.0, 0.0, 0.01)}
    assert verdicts(along(0.0, 1.0, 2.0, **along_it)) == [False, False, True]
    direction = disputed(finding(**along_it), LoopConfig())
    np.testing.assert_allclose(direction, (np.cos(PLACE[2]), np.sin(PLACE[2])))
    assert disputed(finding(ratio=0.8, rival=along_it["rival"]), LoopConfig()) is None
    assert disputed(finding(), LoopConfig()) is None


def test_a_place_on_the_path_needs_no_proof_against_it_but_a_better_fit():
    near = {"off": (0.05, 0.1, 0.02), "ratio": 0.5}
    same = {"there": fits(60, 4)}
    assert verdicts(along(0.0, 1.0, 2.0, **near), **same) == [False, False, True]
    assert not any(verdicts(along(0.0, 1.0, 2.0, **{**near, "ratio": 0.7}), **same))
    assert not any(verdicts(along(0.0, 1.0, 2.0, **near), here=fits(60, 7), there=fits(60, 7)))
    assert not any(verdicts(along(0.0, 1.0, 2.0, **near), here=fits(50, 0), there=fits(50, 0)))


def test_it_waits_until_it_is_told_to_forget_and_survives_being_written_down():
    judge = PartJudge(LoopConfig())
    assert not judge.waits
    looks = along(0.0, 1.0, 2.0)
    for look in looks[:2]:
        assert not judge.believes(look, **GOOD)
    assert judge.waits
    again = PartJudge(LoopConfig())
    again.restore(judge.state())
    assert again.believes(looks[2], **GOOD)
    judge.forget()
    assert not judge.waits
    assert not judge.believes(looks[2], **GOOD)
