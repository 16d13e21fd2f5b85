"""A map in tiles: whoever asks often enough has the whole map, in few bytes, whatever happened in between."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime.tiles import MAX_ANSWER, TILE, Mosaic, Tiles

CELL = 0.05
PLENTY = 10**9


def take(tiles, cells, corner=(0, 0), stamp_ns=7):
    origin = (corner[0] * CELL, corner[1] * CELL)
    return tiles.take(np.asarray(cells, np.int8), CELL, origin, stamp_ns, stamp_ns + 1)


def catch_up(mosaic, tiles, room=MAX_ANSWER):
    """Ask until nothing is left; return the sizes of the answers."""
    sizes = []
    while not sizes or mosaic.left:
        answer = tiles.answer(mosaic.question(room))
        assert len(answer) <= max(room, 60)
        mosaic.take(answer)
        sizes.append(len(answer))
        assert len(sizes) < 1000
    return sizes


def at(picture, x_m, y_m):
    col = round((x_m - picture.origin_m[0]) / CELL)
    row = round((y_m - picture.origin_m[1]) / CELL)
    return int(picture.cells[row, col])


def test_the_pieces_put_together_are_the_map():
    cells = np.random.default_rng(1).integers(-1, 101, (150, 90))
    tiles, mosaic = Tiles(PLENTY), Mosaic()
    grown, parts = take(tiles, cells, (-10, 70), stamp_ns=42)
    catch_up(mosaic, tiles)
    picture = mosaic.picture()
    assert grown
    assert np.array_equal(picture.cells, tiles.picture.cells)
    assert (picture.origin_m, picture.stamp_ns, picture.published_ns) == (tiles.picture.origin_m, 42, 43)
    assert picture.origin_m == (-TILE * CELL, TILE * CELL)
    assert [at(picture, (-10 + c) * CELL, (70 + r) * CELL) for r, c in ((0, 0), (149, 89))] == [
        cells[0, 0],
        cells[149, 89],
    ]
    assert sum(part.width * part.height for part in parts) == tiles.picture.cells.size


def test_only_what_changed_is_sent_again():
    cells = np.random.default_rng(2).integers(0, 101, (3 * TILE, 3 * TILE))
    tiles, mosaic = Tiles(PLENTY), Mosaic()
    take(tiles, cells)
    whole = sum(catch_up(mosaic, tiles))
    assert sum(catch_up(mosaic, tiles)) < 100
    cells[TILE + 5, 2 * TILE + 5] += 1
    grown, parts = take(tiles, cells)
    assert (grown, [(p.x, p.y, p.width, p.height) for p in parts]) == (
        False,
        [(2 * TILE, TILE, TILE, TILE)],
    )
    assert sum(catch_up(mosaic, tiles)) < whole / 5
    assert np.array_equal(mosaic.picture().cells, tiles.picture.cells)


def test_a_map_that_grows_moves_nothing():
    tiles, mosaic = Tiles(PLENTY), Mosaic()
    take(tiles, [[11]], (3, 4))
    catch_up(mosaic, tiles)
    grown, _ = take(tiles, [[22]], (-500, -300))  # and what it knew before is unknown now
    catch_up(mosaic, tiles)
    assert grown
    assert at(mosaic.picture(), -500 * CELL, -300 * CELL) == 22
    assert at(mosaic.picture(), 3 * CELL, 4 * CELL) == -1
    assert take(tiles, [[22]], (-500, -300)) == (False, [])


def test_a_narrow_door_takes_more_questions_and_a_change_meanwhile_is_not_lost():
    rng = np.random.default_rng(3)
    cells = rng.integers(0, 101, (4 * TILE, 4 * TILE))
    tiles, mosaic = Tiles(PLENTY), Mosaic()
    take(tiles, cells)
    room = 10_000
    mosaic.take(tiles.answer(mosaic.question(room)))
    assert 0 < mosaic.left < 16
    cells[:] = rng.integers(0, 101, cells.shape)
    take(tiles, cells)
    assert len(catch_up(mosaic, tiles, room)) > 4
    assert np.array_equal(mosaic.picture().cells, tiles.picture.cells)


def known(picture):
    """Return what is known of a picture, by the cells of the map's frame; tiles of nothing are not sent."""
    if picture is None:
        return {}
    x, y = (round(one / CELL) for one in picture.origin_m)
    return {(x + col, y + row): picture.cells[row, col] for row, col in np.argwhere(picture.cells != -1)}


@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_whoever_asks_at_any_time_ends_with_the_present_map(data):
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    tiles, mosaic = Tiles(PLENTY), Mosaic()
    for _ in range(data.draw(st.integers(1, 6))):
        shape = data.draw(st.tuples(st.integers(1, 200), st.integers(1, 200)))
        corner = data.draw(st.tuples(st.integers(-300, 300), st.integers(-300, 300)))
        take(tiles, rng.integers(-1, 101, shape), corner)
        for _ in range(data.draw(st.integers(0, 2))):
            mosaic.take(tiles.answer(mosaic.question(9_000)))
    catch_up(mosaic, tiles)
    assert known(mosaic.picture()) == known(tiles.picture)


def test_a_mapper_that_began_anew_replaces_the_old_map():
    before, after, mosaic = Tiles(PLENTY), Tiles(PLENTY), Mosaic()
    take(before, np.full((300, 300), 100))
    catch_up(mosaic, before)
    take(after, [[50]])
    catch_up(mosaic, after)
    assert np.array_equal(mosaic.picture().cells, after.picture.cells)


def test_all_askers_together_get_no_more_than_was_said():
    now = [0.0]
    tiles = Tiles(20_000, lambda: now[0])
    take(tiles, np.random.default_rng(4).integers(0, 101, (6 * TILE, 6 * TILE)))
    asked = [Mosaic() for _ in range(5)]
    total = 0
    for _ in range(100):
        now[0] += 0.1
        for mosaic in asked:
            answer = tiles.answer(mosaic.question(16_000))
            total += len(answer)
            mosaic.take(answer)
    # What says that there is nothing yet costs a little, too.
    assert total < 20_000 * (10 + 1) + 500 * 60


def test_an_empty_map_is_answered_and_shows_nothing():
    tiles, mosaic = Tiles(PLENTY), Mosaic()
    assert mosaic.take(tiles.answer(mosaic.question(16_000))) is False
    assert (mosaic.picture(), mosaic.left) == (None, 0)


@pytest.mark.parametrize("spoil", [lambda a: a[:-3], lambda a: a[:60] + b"x" * (len(a) - 60), lambda a: b""])
def test_a_damaged_answer_is_refused_and_asked_for_again(spoil):
    tiles, mosaic = Tiles(PLENTY), Mosaic()
    take(tiles, np.random.default_rng(5).integers(0, 101, (TILE, TILE)))
    with pytest.raises(ValueError, match=r"damaged|reshape"):
        mosaic.take(spoil(tiles.answer(mosaic.question(16_000))))
    catch_up(mosaic, tiles)
    assert np.array_equal(mosaic.picture().cells, tiles.picture.cells)


def test_no_question_no_answer():
    assert Tiles(PLENTY).answer(b"what?") == b""
