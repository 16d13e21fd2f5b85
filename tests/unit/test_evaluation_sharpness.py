"""Figures of sharpness move the way their names say."""

import numpy as np
import pytest

from processing.sharpness import count_passes, sharpness


def room(noise_m, turn_rad=0.0, seed=1, scans=6, count=800):
    """Scans of a square room of 4 m from near its middle."""
    rng = np.random.default_rng(seed)
    points, origins = [], []
    for _ in range(scans):
        t = rng.uniform(-2, 2, count)
        side = rng.integers(0, 4, count)
        wall = np.where(side % 2 == 0, 2.0, -2.0) + rng.normal(0, noise_m, count)
        xy = np.where((side < 2)[:, None], np.column_stack((t, wall)), np.column_stack((wall, t)))
        c, s = np.cos(turn_rad), np.sin(turn_rad)
        points.append(xy @ np.array([[c, s], [-s, c]]))
        origins.append(rng.normal(0, 0.1, 2))
    return points, np.array(origins)


def test_noise_blurs_the_map_and_the_figures_say_so():
    sharp, blurred = sharpness(*room(0.005)), sharpness(*room(0.06))
    assert sharp.mean_map_entropy < blurred.mean_map_entropy - 0.5
    assert sharp.occupied_cells < blurred.occupied_cells
    assert sharp.walls > 0.9
    assert sharp.walls > blurred.walls


def test_a_square_room_is_square_however_it_is_turned():
    assert sharpness(*room(0.005, turn_rad=0.5)).walls > 0.9


def test_walls_at_all_angles_are_parallel_to_nothing():
    angle = np.linspace(0, 2 * np.pi, 4000)
    circle = np.column_stack((3 * np.cos(angle), 3 * np.sin(angle)))
    assert sharpness([circle], np.zeros((1, 2))).walls < 0.1


def test_a_wall_that_other_rays_cross_is_a_conflict():
    points, origins = room(0.005)
    assert sharpness(points, origins).ray_conflict < 0.02
    ghost = np.column_stack((np.linspace(-1, 1, 40), np.full(40, 1.0)))  # a wall amid the room
    haunted = sharpness([*points, ghost], np.vstack((origins, [[0, 0]])))
    assert haunted.ray_conflict == pytest.approx(40 / (6 * 800 + 40), rel=0.3)


def test_a_ray_passes_each_cell_between_its_ends_but_the_last_two():
    passes = np.zeros((3, 12))
    count_passes(passes, np.array([[0.05, 0.15]]), np.array([[1.0, 0.15]]), 0.1)
    assert passes[1].tolist() == [1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0]
    assert passes[0].sum() == passes[2].sum() == 0


def test_a_map_needs_points_and_an_origin_for_each_scan():
    with pytest.raises(ValueError, match="0 points"):
        sharpness([np.zeros((0, 2))], np.zeros((1, 2)))
    with pytest.raises(ValueError, match="2 origins for 1 scans"):
        sharpness([np.zeros((3, 2))], np.zeros((2, 2)))
