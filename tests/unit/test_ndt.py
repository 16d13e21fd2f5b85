"""The compiled transform gives what four plain grids of cells give, and its slopes are those of its score."""

import itertools

import numpy as np
import pytest

from processing.ndt import Ndt, NdtConfig
from processing.se2 import transform
from tests.unit import naive_odometry as naive

CONFIGS = [
    NdtConfig(),
    NdtConfig(flat_stretch=1.0),
    NdtConfig(cell_m=1.0, min_points=5, min_deviation_m=0.05, flat_ratio=0.3, flat_stretch=20.0),
    # The least ratio of the variances decides before a cell counts as flat.
    NdtConfig(min_ratio=0.1, flat_ratio=0.02),
]
HERE = np.zeros(3)


def furnished_room(rng, count=250, noise_m=0.01):
    corners = np.array(((-2.0, -1.5), (2.6, -1.5), (2.6, 1.8), (-2.0, 1.8), (-2.0, -1.5)))
    parts = [
        a + rng.random((count // 5, 1)) * (b - a) + rng.normal(0.0, noise_m, (count // 5, 2))
        for a, b in itertools.pairwise(corners)
    ]
    return np.concatenate([*parts, rng.normal((0.7, 0.2), 0.15, (count // 5, 2))])


def on_walls(rng, points):
    """The same points, two thirds of them on walls that run anyhow: half of these along the room's."""
    angle = rng.uniform(-np.pi, np.pi, len(points))
    along = rng.random(len(points)) < 0.5
    angle[along] = np.round(angle[along] / (0.5 * np.pi)) * 0.5 * np.pi
    normals = np.column_stack((np.cos(angle), np.sin(angle)))
    return np.hstack((points, normals * (rng.random((len(points), 1)) < 0.67)))


def poses(rng, count):
    return rng.uniform((-0.4, -0.4, -0.5), (0.4, 0.4, 0.5), (count, 3))


def built(points, config=None):
    ndt = Ndt(config or NdtConfig())
    ndt.build(points)
    return ndt


@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("blur_m2", [0.0, 0.03**2])
def test_the_score_is_that_of_four_plain_grids(config, blur_m2):
    rng = np.random.default_rng(1)
    reference, points = furnished_room(rng), furnished_room(rng)
    ndt, plain = built(reference, config), naive.Ndt(reference, config)
    for seen in (points, on_walls(rng, points)):
        for pose in (HERE, *poses(rng, 4)):
            expected = plain.score(seen, pose, blur_m2)
            assert ndt.score(seen, pose, blur_m2).value == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert ndt.score(seen, HERE).value != pytest.approx(ndt.score(points, HERE).value)


def test_a_scan_fits_its_own_reference_and_nothing_beside_it():
    points = furnished_room(np.random.default_rng(2))
    ndt = built(points)
    assert 0.6 < ndt.score(points, HERE).value / len(points) <= 1.0
    for moved in ((0.1, 0.0, 0.0), (0.0, -0.1, 0.0), (0.0, 0.0, 0.1)):
        assert ndt.score(points, np.array(moved)).value < 0.8 * ndt.score(points, HERE).value
    assert ndt.score(points, np.array((50.0, 0.0, 0.0))).value == 0.0


def differences(score, pose, step):
    """Central differences of a function with one or more values, along x, y and yaw."""
    return np.array([(score(pose + step * d) - score(pose - step * d)) / (2.0 * step) for d in np.eye(3)])


@pytest.mark.parametrize("with_walls", [False, True])
@pytest.mark.parametrize("blur_m2", [0.0, 0.03**2])
@pytest.mark.parametrize("seed", range(4))
def test_gradient_and_hessian_are_the_differences_of_the_score_at_fixed_weights(seed, blur_m2, with_walls):
    rng = np.random.default_rng(seed)
    reference, points = furnished_room(rng), furnished_room(rng, 60)
    points = on_walls(rng, points) if with_walls else points
    config = NdtConfig()
    plain = naive.Ndt(reference, config)
    pose = poses(rng, 1)[0]

    def value(at):
        return plain.score(points, at, blur_m2, weighed_at=pose)

    score = built(reference, config).score(points, pose, blur_m2)
    scale = np.abs(score.hessian).max()
    np.testing.assert_allclose(score.gradient, differences(value, pose, 1e-6), atol=1e-6 * scale)
    slopes = differences(lambda at: differences(value, at, 1e-4), pose, 1e-4)
    np.testing.assert_allclose(score.hessian, slopes, atol=2e-3 * scale)
    np.testing.assert_array_equal(score.hessian, score.hessian.T)


@pytest.mark.parametrize("seed", range(4))
def test_the_information_is_never_negative_and_the_hessian_of_a_perfect_fit(seed):
    rng = np.random.default_rng(seed)
    reference = furnished_room(rng)
    ndt = built(reference)
    for pose in poses(rng, 5):
        information = ndt.score(on_walls(rng, furnished_room(rng)), pose).information
        np.testing.assert_array_equal(information, information.T)
        assert np.linalg.eigvalsh(information).min() > -1e-9 * np.trace(information)
    # One point in the middle of round cells: nothing is left of the Hessian but the Gauss-Newton part.
    ring = 0.05 * np.array(((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)))
    middle = np.array((0.125, 0.125))
    score = built(middle + ring).score(middle[None], HERE)
    assert score.value == pytest.approx(1.0)
    np.testing.assert_allclose(score.information, -score.hessian, atol=1e-6)
    assert score.information[0, 0] == pytest.approx(1.0 / (0.5 * 0.05**2))


@pytest.mark.parametrize("cells", [(1, 0), (-7, 3), (2000, -4000)])
def test_nothing_changes_when_all_move_by_whole_cells(cells):
    rng = np.random.default_rng(3)
    reference, points, pose = furnished_room(rng), furnished_room(rng), poses(rng, 1)[0]
    shift = 0.5 * np.array(cells)
    here, there = built(reference), built(reference + shift)
    assert there.cells == here.cells
    moved = pose + np.append(shift, 0.0)
    first, second = here.score(points, pose), there.score(points, moved)
    assert second.value == pytest.approx(first.value, rel=1e-6)
    np.testing.assert_allclose(second.gradient, first.gradient, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(second.information, first.information, rtol=1e-5, atol=1e-3)
    assert there.sampled_score(points, moved) == pytest.approx(here.sampled_score(points, pose), rel=1e-2)


def test_the_raster_is_near_the_exact_score_of_widened_cells():
    rng = np.random.default_rng(4)
    reference = furnished_room(rng)
    ndt = built(reference)
    for pose in poses(rng, 20):
        points = furnished_room(rng)
        exact = ndt.score(points, pose, ndt.raster_variance).value
        assert ndt.sampled_score(points, pose) == pytest.approx(exact, abs=0.02 * len(points))


def test_a_sample_is_the_score_of_the_middle_of_its_square():
    rng = np.random.default_rng(5)
    ndt = built(furnished_room(rng))
    side = 0.5 / 2 / 4
    middles = (np.floor(rng.uniform((-2.2, -1.7), (2.8, 2.0), (400, 2)) / side) + 0.5) * side
    for middle in middles:
        anywhere = (middle + rng.uniform(-0.49, 0.49, 2) * side)[None]
        exact = ndt.score(middle[None], HERE, ndt.raster_variance).value
        # The table of exponentials has steps of 1/32 of the squared distance.
        assert ndt.sampled_score(anywhere, HERE) == pytest.approx(exact, abs=0.017)


def test_the_score_has_no_step_where_a_point_crosses_into_other_cells():
    rng = np.random.default_rng(6)
    ndt = built(rng.uniform(-1.0, 1.0, (400, 2)), NdtConfig(flat_stretch=1.0))
    crossings = [(k * 0.25, y) for k in range(-3, 4) for y in rng.uniform(-0.9, 0.9, 10)]
    for x, y in crossings:
        for before, after in (((x - 1e-9, y), (x + 1e-9, y)), ((y, x - 1e-9), (y, x + 1e-9))):
            first, second = (ndt.score(np.array((p,)), HERE).value for p in (before, after))
            assert first > 0.05
            assert second == pytest.approx(first, abs=1e-6)


def test_fewer_points_than_the_least_make_no_cell():
    # 0.1 .. 0.15 lies in one half cell, so in four cells with the same points.
    three = np.array(((0.1, 0.1), (0.15, 0.12), (0.12, 0.15)))
    assert built(three[:2]).score(three, HERE).value == 0.0
    assert built(three[:2]).sampled_score(three, HERE) == 0.0
    assert built(three).score(three, HERE).value > 1.0
    assert built(three).sampled_score(three, HERE) > 1.0
    assert built(three, NdtConfig(min_points=4)).score(three, HERE).value == 0.0


def test_an_empty_reference_scores_nothing_also_after_a_full_one():
    points = furnished_room(np.random.default_rng(7))
    ndt = Ndt(NdtConfig())
    for _ in range(2):
        score = ndt.score(points, HERE)
        assert score.value == ndt.sampled_score(points, HERE) == 0.0
        assert not score.gradient.any()
        assert not score.hessian.any()
        assert not score.information.any()
        assert ndt.cells == 0
        ndt.build(points)
        assert ndt.cells > 0
        ndt.build(np.empty((0, 2)))


def test_no_points_score_nothing():
    ndt = built(furnished_room(np.random.default_rng(7)))
    assert ndt.score(np.empty((0, 2)), HERE).value == 0.0
    assert ndt.sampled_score(np.empty((0, 2)), HERE) == 0.0


def test_a_reference_built_after_others_is_as_one_built_at_first():
    rng = np.random.default_rng(8)
    used = Ndt(NdtConfig(), capacity=16)
    for size in (10, 400, 60):
        used.build(furnished_room(rng, size) * rng.uniform(0.5, 8.0) + rng.uniform(-30.0, 30.0, 2))
    reference, points, pose = furnished_room(rng), furnished_room(rng), poses(rng, 1)[0]
    used.build(reference)
    fresh = built(reference, NdtConfig())
    assert used.cells == fresh.cells
    np.testing.assert_array_equal(used.score(points, pose).gradient, fresh.score(points, pose).gradient)
    assert used.score(points, pose).value == fresh.score(points, pose).value > 0.0
    assert used.sampled_score(points, pose) == fresh.sampled_score(points, pose) > 0.0


@pytest.mark.parametrize("angle_rad", [0.0, 0.6, np.pi / 2, 2.5])
def test_a_wall_constrains_across_itself_and_not_along(angle_rad):
    turn = np.array((0.0, 0.0, angle_rad))
    wall = transform(turn, np.column_stack((np.arange(-3.0, 3.0, 0.02), np.full(300, 0.1))))
    points = transform(turn, np.column_stack((np.arange(-1.0, 1.0, 0.04), np.full(50, 0.1))))
    ndt = built(wall)
    along, across = transform(turn, np.eye(2))
    here = ndt.score(points, HERE)
    information = here.information[:2, :2]
    # What is left along are the short ends in the corners of cells, no longer than a surface is thick.
    assert along @ information @ along < 0.01 * (across @ information @ across)
    assert ndt.score(points, np.array((*(0.3 * along), 0.0))).value == pytest.approx(here.value, rel=0.01)
    assert ndt.score(points, np.array((*(0.1 * across), 0.0))).value < 0.05 * here.value
    # Without the stretch, the ends of the pieces would hold the wall.
    kept = built(wall, NdtConfig(flat_stretch=1.0)).score(points, HERE).information[:2, :2]
    assert along @ kept @ along > 3.0 * (along @ information @ along)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"cell_m": 0.01}, "cell_m = 0.01"),
        ({"min_points": 1}, "min_points = 1"),
        ({"min_deviation_m": 0.6}, "min_deviation_m = 0.6"),
        ({"min_ratio": -0.1}, "min_ratio, flat_ratio = -0.1"),
        ({"flat_ratio": 1.1}, "flat_ratio = 0.001, 1.1"),
        ({"flat_stretch": 0.5}, "flat_stretch = 0.5"),
    ],
)
def test_a_cell_that_cannot_be_is_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        NdtConfig(**wrong)
