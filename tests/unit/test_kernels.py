"""Every compiled loop has a written signature, frees the interpreter, is cached, and has a plain twin.

A kernel without a signature compiles again in mid-run for the first read-only array; one that holds the
interpreter stalls every other thread; one without a cache costs seconds at each start; one without a twin is
believed on its own word.
"""

import dataclasses
import importlib
import importlib.util
import pkgutil
from pathlib import Path

import numpy as np
import pytest
from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher

import processing
from drivers.world import Urg04lx, corridor, pillar_hall, room
from processing.evolution import EvolutionConfig
from processing.matching import Matcher, MatchingConfig
from processing.matching_kernels import mahalanobis, solve
from processing.ndt import Ndt, NdtConfig, Score
from processing.ndt_kernels import point_score
from processing.prediction import Prior
from processing.saliency import ResamplingConfig
from processing.saliency_kernels import resample
from processing.scan import Beams, Scan, end_points
from processing.wide_match_kernels import blur
from tests.unit import naive_odometry as naive

DPSLAM = "unit/test_dpslam_naive.py::test_the_filter_equals_one_that_copies_whole_maps"
SLOPES = "unit/test_ndt.py::test_gradient_and_hessian_are_the_differences_of_the_score_at_fixed_weights"
PASSES = "unit/test_evaluation_sharpness.py::test_a_ray_passes_each_cell_between_its_ends_but_the_last_two"
SIDES = "unit/test_dpslam_settled.py::test_what_faces_away_is_what_a_plain_look_at_the_points_says"
SETTLED = "unit/test_dpslam_settled.py::test_the_fit_of_each_point_is_that_of_four_plain_grids"
SCORE = "unit/test_ndt.py::test_the_score_is_that_of_four_plain_grids"

TWINS = {
    "evolution_kernels": {
        "uniform": "unit/test_evolution.py::test_the_random_numbers_are_those_of_splitmix64",
        "scatter": "unit/test_evolution.py::test_every_member_is_that_of_the_plain_twin",
        "propose": "unit/test_evolution.py::test_every_member_is_that_of_the_plain_twin",
        "gathered": "unit/test_evolution.py::test_the_search_ends_when_all_members_lie_together",
    },
    "matching_kernels": {
        "mahalanobis": "unit/test_kernels.py::test_the_distance_from_the_prior_is_the_quadratic_form",
        "log_prior": "unit/test_matching.py::test_the_compiled_search_takes_the_steps_of_the_plain_one",
        "search": "unit/test_matching.py::test_the_compiled_search_takes_the_steps_of_the_plain_one",
        "blend": "unit/test_kernels.py::test_the_compiled_polish_ends_where_the_plain_one_does",
        "newton_step": "unit/test_kernels.py::test_the_compiled_polish_ends_where_the_plain_one_does",
        "solve": "unit/test_kernels.py::test_three_equations_are_solved_or_refused_as_by_numpy",
        "polish": "unit/test_kernels.py::test_the_compiled_polish_ends_where_the_plain_one_does",
    },
    "certainty_kernels": {
        "add_slope": "unit/test_certainty.py::test_the_spreads_are_the_sums_over_single_points",
        "spreads": "unit/test_certainty.py::test_the_spreads_are_the_sums_over_single_points",
    },
    "wall_kernels": {
        "": "unit/test_walls.py::test_the_compiled_filling_is_the_plain_one",
    },
    "facing_kernels": {
        "across": "unit/test_local_map.py::test_the_compiled_normals_are_the_plain_ones",
        "face": "unit/test_local_map.py::test_the_compiled_normals_are_the_plain_ones",
        "lean": "unit/test_local_map.py::test_lone_far_hits_are_those_of_the_plain_twin",
        "look_behind": "unit/test_local_map.py::test_what_is_seen_from_behind_is_that_of_the_plain_twin",
    },
    "sight_kernels": {"": "unit/test_sightlines.py::test_the_compiled_look_back_is_the_plain_one"},
    "walker_kernels": {
        "things_of": "unit/test_walkers.py::test_things_are_what_hangs_together",
        "": "unit/test_walkers.py::test_the_compiled_look_is_the_plain_one",
    },
    "ndt_kernels": {
        "accumulate": SCORE,
        "fit": SCORE,
        "fit_block": SCORE,
        "fit_blocks": SCORE,
        "point_score": "unit/test_kernels.py::test_the_score_of_a_point_is_that_of_four_plain_grids",
        "sample_tiles": "unit/test_ndt.py::test_a_sample_is_the_score_of_the_middle_of_its_square",
        "clear": "unit/test_ndt.py::test_a_reference_built_after_others_is_as_one_built_at_first",
        "sampled_score": "unit/test_ndt.py::test_the_raster_is_near_the_exact_score_of_widened_cells",
        "across_wall": SCORE,
        "derivatives": SLOPES,
    },
    "saliency_kernels": {
        "end_points": "property/test_scan_inputs.py::test_the_compiled_end_points_are_the_plain_ones",
        "": "unit/test_kernels.py::test_the_means_are_those_of_the_plain_resampling",
    },
    "wide_match_kernels": {
        "blur": "unit/test_kernels.py::test_a_blurred_cell_is_the_bell_of_the_nearest_point",
        "lower": "unit/test_wide_match.py::test_rays_lower_what_they_passed_but_no_wall",
        "least_cost": "unit/test_wide_match.py::test_no_cell_of_a_square_costs_less_than_the_square",
        "raise_pyramid": "unit/test_wide_match.py::test_every_level_bounds_the_cells_under_it",
        "": "unit/test_wide_match.py::test_the_best_of_the_window_equals_the_best_of_every_cell",
    },
    "smoothing_kernels": {"": "unit/test_smoothing.py::test_the_solution_equals_a_dense_one"},
    "sharpness": {"": PASSES},
    "dpslam.alignment": {"": DPSLAM},
    "dpslam.ancestry": {"": DPSLAM},
    "dpslam.grid": {"": DPSLAM},
    "dpslam.kernels": {"": DPSLAM},
    "dpslam.laser_model": {"": DPSLAM},
    "dpslam.settled_kernels": {
        "note_views": SIDES,
        "block_is_away": SIDES,
        "look_away": SIDES,
        "look_through": "unit/test_dpslam_loops.py::test_a_square_is_passed_where_two_rays_went_through",
        "": SETTLED,
    },
    "dpslam.writing": {"": DPSLAM},
}  # fmt: skip
"""Module -> kernel -> the test that holds it against something plain; "" are those that its others call."""


def kernels():
    """All compiled functions: (module without the package, name, function)."""
    for module in pkgutil.walk_packages(processing.__path__, "processing."):
        for name, thing in vars(importlib.import_module(module.name)).items():
            if isinstance(thing, Dispatcher) and thing.py_func.__module__ == module.name:
                yield module.name.removeprefix("processing."), name, thing


KERNELS = list(kernels())


def each(chosen):
    ids = [f"{module}.{name}" for module, name, _ in chosen]
    return pytest.mark.parametrize(("module", "name", "kernel"), chosen, ids=ids)


def test_the_kernels_of_the_odometry_are_all_found():
    assert {("ndt_kernels", "derivatives"), ("saliency_kernels", "resample")} <= {k[:2] for k in KERNELS}
    assert len(KERNELS) > 50


@each(KERNELS)
def test_a_kernel_is_compiled_ahead_for_written_types_frees_the_interpreter_and_is_cached(
    module, name, kernel
):
    assert kernel.signatures, "no signature is written: the first call with new types compiles in mid-run"
    assert kernel.targetoptions.get("nogil"), "holds the interpreter while it runs"
    assert not kernel.targetoptions.get("parallel"), "takes the other cores from the other processes"
    assert not isinstance(kernel._cache, NullCache), "compiles at every start"
    with pytest.raises(TypeError):
        kernel(*["no array"] * len(kernel.signatures[0]))


@each(KERNELS)
def test_a_kernel_is_held_against_something_plain(module, name, kernel):
    assert module in TWINS, f"{module} has kernels and no entry in TWINS"
    test = TWINS[module].get(name) or TWINS[module].get("")
    assert test, f"{module}.{name} has no entry in TWINS: write its twin, and name the test"
    file, _, function = test.partition("::")
    text = (Path(__file__).parents[1] / file).read_text()
    assert f"\ndef {function}(" in text


def test_no_twin_is_named_that_no_kernel_has():
    found = {(module, name) for module, name, _ in KERNELS}
    named_twins = {(module, name) for module, twins in TWINS.items() for name in twins if name}
    assert named_twins <= found


# What had no twin elsewhere.


def sweeps():
    """Points (N, 2), the numbers of their rays and the step of the bearing, of real and of hostile sweeps."""
    laser = Urg04lx()
    beams = Beams(
        count=laser.beams,
        angle_min_rad=laser.angle_min_rad,
        angle_increment_rad=laser.angle_increment_rad,
        range_max_m=laser.range_max_m,
    )
    seen = [
        laser.measure(building, np.tile(pose, (laser.beams, 1)), np.random.default_rng(seed))
        for seed, (building, pose) in enumerate(
            ((room(), (1.5, 1.5, 0.3)), (corridor(), (8.0, 1.0, 0.5)), (pillar_hall(), (1.2, 1.2, 2.0)))
        )
    ]
    rng = np.random.default_rng(7)
    seen.append(rng.uniform(0.1, 5.0, laser.beams).astype(np.float32))
    seen.append(np.where(rng.random(laser.beams) < 0.9, np.nan, seen[0]))
    seen += [np.where(np.arange(laser.beams) < count, seen[1][::-1], np.nan) for count in (0, 150, 400)]
    for ranges_m in seen:
        points, rays = end_points(Scan(0, ranges_m, beams), np.zeros(3))
        yield points, rays, beams.angle_increment_rad


@pytest.mark.parametrize(
    "config",
    [
        ResamplingConfig(),
        ResamplingConfig(points=30, bend_weight=0.0, short_weight=0.0),
        ResamplingConfig(points=60, bend_support_m=0.4, bend_weight=20.0, short_weight=8.0, short_m=0.2),
        ResamplingConfig(points=400, max_slant=1.5, range_noise_m=0.005),
    ],
)
def test_the_means_are_those_of_the_plain_resampling(config):
    c = config
    rule = (c.max_slant, c.range_noise_m, c.bend_support_m, c.bend_weight, c.short_weight, c.short_m)
    for points, rays, step in sweeps():
        count = len(points)
        means, members, work = np.empty((count, 2)), np.empty(count, np.int64), np.empty((count, 4))
        written = resample(points, rays, count, step, c.points, np.array(rule), means, members, work)
        plain = naive.Resampled(points, rays, step, config)
        assert members[:written].tolist() == plain.members
        np.testing.assert_allclose(means[:written], plain.means, atol=1e-12)


def reference(seed):
    rng = np.random.default_rng(seed)
    points = np.concatenate(
        (
            np.column_stack((rng.uniform(-2.0, 2.5, 150), rng.normal(-1.4, 0.01, 150))),
            np.column_stack((rng.normal(2.5, 0.01, 100), rng.uniform(-1.4, 1.8, 100))),
            rng.normal((0.6, 0.3), 0.15, (50, 2)),
        )
    )
    ndt = Ndt(NdtConfig())
    ndt.build(points)
    return ndt, points


def test_the_score_of_a_point_is_that_of_four_plain_grids():
    ndt, points = reference(1)
    plain = naive.Ndt(points, NdtConfig())
    rng = np.random.default_rng(2)
    for point in points[::10] + rng.normal(0.0, 0.02, (30, 2)):
        u, v = point - ndt.origin[:2]
        row, col = int(v * ndt.origin[2]), int(u * ndt.origin[2])
        found = point_score(u, v, row, col, ndt.slots, ndt.normals, ndt.origin[2], 0.0)
        assert found == pytest.approx(plain.point_score(point), abs=1e-9)


def prior_of(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3))
    return rng.normal(0.0, 0.1, 3), 30.0 * (root @ root.T + np.eye(3))


def test_the_distance_from_the_prior_is_the_quadratic_form():
    for seed in range(5):
        pose, information = prior_of(seed)
        prior = np.array((*pose, *information.ravel(), 4.0, 0.3))
        for off in np.random.default_rng(seed).normal(size=(5, 3)):
            assert mahalanobis(prior, *(pose + off)) == pytest.approx(off @ information @ off)


@pytest.mark.parametrize("seed", range(8))
def test_the_compiled_polish_ends_where_the_plain_one_does(seed):
    ndt, points = reference(seed)
    pose, information = prior_of(seed)
    # Half of them far off, where a step is cut short.
    pose *= 1 + 2 * (seed % 2)
    config = MatchingConfig(search=EvolutionConfig(generations=0))
    # Without a search the polish begins at the prior, where Student's t is the narrowest.
    trust = (config.freedom + 3.0) / config.freedom
    stages = ((config.coarse_deviation_m**2, 0.0), (0.0, config.fine_share))
    weight = config.score_weight

    def blended(at, blur_m2, share):
        wide, fine = ndt.score(points, at, blur_m2), ndt.fine.score(points, at, blur_m2)
        names = (field.name for field in dataclasses.fields(Score))
        return Score(*((1.0 - share) * getattr(wide, n) + share * getattr(fine, n) for n in names))

    plain = naive.polish(blended, pose, information, trust, weight, stages, pose)
    found = Matcher(config).match(points, ndt, Prior(pose, information))
    assert np.abs(plain - pose).max() > 0.02
    np.testing.assert_allclose(found.pose, plain, atol=1e-8)
    there = blended(found.pose, 0.0, config.fine_share)
    assert found.score == pytest.approx(there.value / len(points), rel=1e-9)
    np.testing.assert_allclose(found.information, weight * there.information, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(found.hessian, weight * there.hessian, rtol=1e-9, atol=1e-6)
    assert found.polish_steps > 2


def test_three_equations_are_solved_or_refused_as_by_numpy():
    rng = np.random.default_rng(0)
    for _ in range(50):
        root, right, out = rng.normal(size=(3, 3)), rng.normal(size=3), np.empty(3)
        matrix = root @ root.T + 0.01 * np.eye(3)
        assert solve(matrix, right, out)
        np.testing.assert_allclose(out, np.linalg.solve(matrix, right), rtol=1e-6)
        # One direction turned over: symmetric, and not positive definite.
        values, vectors = np.linalg.eigh(matrix)
        values[rng.integers(3)] *= -1.0
        assert not solve(np.ascontiguousarray(vectors @ np.diag(values) @ vectors.T), right, out)
    assert not solve(np.zeros((3, 3)), right, out)
    assert not solve(np.outer(right, right), right, out)
    assert not solve(np.full((3, 3), np.nan), right, out)


def test_a_blurred_cell_is_the_bell_of_the_nearest_point():
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.2, 2.2, (25, 2))
    field = np.zeros((20, 24), np.float32)
    blur(points, 0.0, 0.0, 0.1, 0.12, field)
    rows, cols = np.mgrid[:20, :24]
    middles = np.stack((0.1 * (cols + 0.5), 0.1 * (rows + 0.5)), axis=-1)
    nearest = np.linalg.norm(middles[:, :, None] - points, axis=-1).min(axis=-1)
    bell = np.exp(-0.5 * (nearest / 0.12) ** 2)
    # The bell is cut off at three deviations, by whole cells: only beyond may it be missing.
    np.testing.assert_allclose(field[nearest < 0.35], bell[nearest < 0.35], atol=1e-6)
    assert np.all((field <= bell + 1e-6) & (field >= np.where(nearest < 0.35, bell - 1e-6, 0.0)))
