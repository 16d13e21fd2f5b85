import io

import numpy as np
import pytest
from PIL import Image

from runtime.reports import picture

RED, BLUE = np.array(picture.PATH), np.array(picture.HITS)


def room(rows=60, cols=100):
    """A walled room, 3 m by 5 m with cells of 5 cm, unknown around it."""
    grid = np.full((rows + 40, cols + 40), np.nan, dtype=np.float32)
    grid[20 : 20 + rows, 20 : 20 + cols] = 0.0
    grid[20, 20 : 20 + cols] = grid[19 + rows, 20 : 20 + cols] = 1.0
    grid[20 : 20 + rows, 20] = grid[20 : 20 + rows, 19 + cols] = 1.0
    return grid


def near(image, colour, tolerance=12):
    """Pixels (N, 2) row, col that show a colour."""
    distance = np.abs(np.asarray(image).astype(int) - colour).max(axis=-1)
    return np.argwhere(distance <= tolerance)


def test_the_same_arrays_give_the_same_bytes():
    path = np.column_stack((np.linspace(1.5, 5.0, 50), np.linspace(1.5, 3.0, 50)))
    first, second = (picture.png(picture.render(room(), 0.05, (0.0, 0.0), path)) for _ in range(2))
    assert first == second
    assert Image.open(io.BytesIO(first)).size == picture.render(room(), 0.05, (0.0, 0.0), path).size


def test_walls_are_dark_free_is_white_and_unknown_is_neither():
    image = picture.render(room(), 0.05, (0.0, 0.0))
    pixels = {tuple(c) for c in np.asarray(image).reshape(-1, 3)}
    assert {picture.WALL, picture.FREE, picture.UNKNOWN} <= pixels


def test_y_points_up_and_x_to_the_right():
    path = np.array([[1.2, 1.2], [5.8, 1.2]])  # along the lower wall
    image = picture.render(room(), 0.05, (0.0, 0.0), path)
    rows, cols = near(image, RED).mean(axis=0)
    assert rows > 0.6 * image.height
    upper = picture.render(room(), 0.05, (0.0, 0.0), path + np.array((0.0, 2.4)))
    assert near(upper, RED)[:, 0].mean() < 0.4 * upper.height
    assert 0.4 * image.width < cols < 0.6 * image.width


def test_the_trajectory_lies_where_the_map_has_its_cells():
    grid = np.full((100, 100), 0.0, dtype=np.float32)
    grid[50, :] = 1.0
    path = np.array([[-4.0, 0.025], [4.0, 0.025]])  # right on the wall
    image = picture.render(grid, 0.05, (-2.5, -2.5), path)
    wall_rows = near(picture.render(grid, 0.05, (-2.5, -2.5)), np.array(picture.WALL))[:, 0]
    # The second picture is narrower (no path outside the grid), so compare in metres over the strip's height.
    red = near(image, RED)
    px_per_m = (image.height - 44) / 6.0  # 5 m of grid and 0.5 m of margin twice
    wall_m = (wall_rows.mean() + 0.5) / ((picture.render(grid, 0.05, (-2.5, -2.5)).height - 44) / 6.0)
    middle = red[np.abs(red[:, 1] - image.width / 2) < 0.2 * image.width, 0]
    assert (middle.mean() + 0.5) / px_per_m == pytest.approx(wall_m, abs=0.03)


def test_a_path_that_leaves_the_grid_widens_the_picture():
    inside = picture.render(room(), 0.05, (0.0, 0.0), [[2.0, 2.0], [3.0, 2.0]])
    outside = picture.render(room(), 0.05, (0.0, 0.0), [[2.0, 2.0], [20.0, 2.0]])
    assert outside.width / outside.height > 2 * inside.width / inside.height


def test_a_huge_map_keeps_its_thin_walls():
    grid = np.zeros((3000, 3000), dtype=np.float32)
    grid[:, 1501] = 1.0
    image = picture.render(grid, 0.05, (0.0, 0.0), size_px=500)
    assert max(image.size) < 600
    assert len(near(image, np.array(picture.WALL))) >= 425  # as many rows as the map has in the picture


def test_hits_are_blue_and_truth_is_grey_under_the_path():
    hits = np.array([[2.0, 2.0], [2.5, 2.5]])
    truth = np.array([[1.5, 3.5], [5.0, 3.5]])
    image = picture.render(room(), 0.05, (0.0, 0.0), hits=hits, truth=truth)
    assert len(near(image, BLUE)) >= 8
    assert len(near(image, np.array(picture.TRUTH))) >= 100


def test_a_map_of_which_nothing_is_known_is_still_a_picture():
    image = picture.render(np.full((10, 10), np.nan, dtype=np.float32), 0.05, (0.0, 0.0))
    assert len(near(image, np.array(picture.UNKNOWN))) > 1000


@pytest.mark.parametrize(("fits_m", "bar_m"), [(0.9, 0.5), (1.0, 1.0), (4.9, 2.0), (60.0, 50.0), (199, 100)])
def test_the_scale_bar_is_a_round_number_that_fits(fits_m, bar_m):
    assert picture.round_step(fits_m) == bar_m


def ink(image):
    """Columns of the lower strip that have letters or the bar in them."""
    return np.unique(near(image, np.array(picture.INK), tolerance=60)[:, 1])


def test_a_caption_that_is_too_long_for_a_narrow_map_goes_on_under_it():
    tower = np.zeros((200, 40), dtype=np.float32)  # 180 px wide
    bare, short, long = (
        picture.render(tower, 0.05, (0.0, 0.0), caption=words, size_px=700)
        for words in ("", "a b", "three hundred and thirty-three points of one sweep")
    )
    assert bare.size == short.size
    assert long.width == short.width
    assert long.height > short.height + 40
    assert ink(long).max() < long.width - 8
    assert near(long, np.array(picture.INK), tolerance=60)[:, 0].max() > short.height


def test_a_word_that_is_wider_than_the_map_widens_the_page():
    tower = np.zeros((200, 8), dtype=np.float32)
    image = picture.render(tower, 0.05, (0.0, 0.0), caption="counterrevolutionaries", size_px=200)
    assert ink(image).max() < image.width - 8


def test_the_scale_bar_has_the_length_that_it_names():
    grid = np.zeros((200, 400), dtype=np.float32)  # 10 m by 20 m, 21 m with the margins: a bar of 5 m
    image = picture.render(grid, 0.05, (0.0, 0.0))
    strip = np.asarray(image)[-24:-21, : image.width // 2].astype(int)
    bar = np.flatnonzero((np.abs(strip - picture.INK).max(axis=-1) < 20).any(axis=0))
    bar = bar[: np.flatnonzero(np.diff(bar) > 3)[0] + 1] if (np.diff(bar) > 3).any() else bar
    assert np.ptp(bar) == pytest.approx(5.0 * image.width / 21.0, rel=0.02)


@pytest.mark.parametrize("shape", [(0, 5), (5,), (2, 2, 2)])
def test_a_grid_of_another_shape_is_named(shape):
    with pytest.raises(ValueError, match="shape"):
        picture.render(np.zeros(shape, dtype=np.float32), 0.05, (0.0, 0.0))


def test_a_resolution_of_nothing_is_named():
    with pytest.raises(ValueError, match="resolution_m = 0"):
        picture.render(room(), 0.0, (0.0, 0.0))
