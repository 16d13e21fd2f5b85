"""Tiles are shared by exactly those who own them, and every particle reads what it wrote."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.dpslam.grid import CELL_M, NONE, TILE_M, TileStore, own_tile

PARTICLES = 4

writes = st.tuples(
    st.just("write"), st.integers(0, PARTICLES - 1), st.integers(-4, 3), st.integers(-4, 3), st.integers(1, 9)
)
selections = st.lists(st.integers(0, PARTICLES - 1), min_size=PARTICLES, max_size=PARTICLES).map(
    lambda chosen: ("select", chosen)
)
events = st.lists(
    st.one_of(writes, selections, st.just(("share",)), st.just(("clear",))), min_size=1, max_size=40
)


def arrange(chosen):
    children = np.bincount(chosen, minlength=PARTICLES)
    parents = np.arange(PARTICLES, dtype=np.int32)
    parents[children == 0] = np.repeat(parents, np.maximum(children - 1, 0))
    return parents


def play(store, maps, sequence):
    """Do the same to the store and to dictionaries {tile place: value} that are copied whole."""
    for event in sequence:
        if event[0] == "write":
            _, particle, row, col, value = event
            store.reserve(1)
            e = store.extent
            tile = own_tile(store.arrays, store.table, particle, row - e.first_row, col - e.first_col)
            store.arrays[0][tile, 0] += value
            maps[particle][row, col] = maps[particle].get((row, col), 0) + value
        elif event[0] == "select":
            parents = arrange(event[1])
            store.resample(parents)
            maps[:] = [dict(maps[p]) for p in parents]
        elif event[0] == "clear":
            store.clear()
            maps[:] = [{} for _ in maps]
        else:
            # Sharing gives one map to particles whose own are empty.
            kept = [dict(event) for event in maps]
            store.clear()
            maps[:] = [{} for _ in maps]
            for (row, col), value in sorted(kept[0].items()):
                play(store, maps, [("write", 0, row, col, value)])
            store.share(0)
            maps[:] = [dict(maps[0]) for _ in maps]


def check(store, maps):
    owners, free, count = store.arrays[4:]
    used = store.table[store.table != NONE]
    assert np.array_equal(np.bincount(used, minlength=len(owners)), owners)
    assert sorted(free[: count[0]].tolist()) == np.flatnonzero(owners == 0).tolist()
    e = store.extent
    for particle, own in enumerate(maps):
        seen = {
            (int(row) + e.first_row, int(col) + e.first_col): int(store.arrays[0][tile, 0])
            for row, col in np.argwhere(store.table[particle] != NONE)
            for tile in [store.table[particle, row, col]]
        }
        assert seen == own


@given(events)
@settings(max_examples=150, deadline=None)
def test_every_particle_reads_what_it_wrote_and_owners_are_counted_exactly(sequence):
    store, maps = TileStore(PARTICLES, tiles=3), [{} for _ in range(PARTICLES)]
    play(store, maps, sequence)
    check(store, maps)


@given(events, events)
@settings(max_examples=50, deadline=None)
def test_a_restored_store_goes_on_as_the_first_one(before, after):
    store, maps = TileStore(PARTICLES, tiles=3), [{} for _ in range(PARTICLES)]
    play(store, maps, before)
    twin, twin_maps = TileStore(PARTICLES), [dict(own) for own in maps]
    twin.restore(store.state())
    play(store, maps, after)
    play(twin, twin_maps, after)
    check(twin, maps)
    for name, value in store.state().items():
        assert np.array_equal(value, twin.state()[name]), name


def test_the_tables_grow_and_keep_what_they_hold():
    store = TileStore(2, tiles=4)
    tile = own_tile(store.arrays, store.table, 1, 0 - store.extent.first_row, 0 - store.extent.first_col)
    store.arrays[0][tile, 0] = 7
    store.cover(np.array((-30.0, -5.0)), np.array((3.0, 80.0)))
    e = store.extent
    assert e.first_col * TILE_M <= -30.0
    assert (e.first_row + e.rows) * TILE_M >= 80.0
    assert store.table[1, -e.first_row, -e.first_col] == tile
    cells, (row, col) = store.dense(1)
    assert cells[-row, -col, 0] == 7
    assert cells.sum() == 7
    assert cells.shape[0] * CELL_M == pytest.approx(e.rows * TILE_M)


def test_a_survivor_that_would_change_its_place_is_an_error():
    with pytest.raises(ValueError, match=r"parents\[0\] = 1, a survivor must be its own parent"):
        TileStore(2).resample(np.array((1, 0), dtype=np.int32))


def test_memory_used_counts_tiles_and_tables():
    store = TileStore(2, tiles=4)
    empty = store.bytes_used
    own_tile(store.arrays, store.table, 0, 1, 1)
    store.share(0)
    assert store.tiles_used == 1
    assert store.bytes_used - empty == 8 * 32 * 32 + 6 * 4 * 64 + 64


def test_memory_held_is_that_of_the_most_tiles_that_were_in_use_at_once():
    store = TileStore(2, tiles=4)
    for col in (1, 2):
        own_tile(store.arrays, store.table, 0, 1, col)
    store.note_use()
    two = store.bytes_held
    assert two == store.bytes_used
    store.clear()
    assert store.bytes_held == two > store.bytes_used
    own_tile(store.arrays, store.table, 0, 1, 1)
    assert store.bytes_held == two
    # The larger pool holds what is in use, and no page of what only was.
    store.reserve(100)
    assert store.bytes_held == store.bytes_used < two
    assert np.array_equal(store.dense(0)[0], np.zeros((8 * 32, 8 * 32, 4)))
