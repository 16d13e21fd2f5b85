"""Arrays that grow."""

import numpy as np
import pytest

from processing.growing import Growing


@pytest.mark.parametrize("shape", [(), (3,), (3, 3)])
def test_what_was_appended_is_there_in_order_however_much_it_is(shape):
    rng = np.random.default_rng(1)
    rows, growing = rng.normal(size=(500, *shape)), Growing(shape)
    for count, row in enumerate(rows):
        assert len(growing) == count
        np.testing.assert_array_equal(growing.rows, rows[:count])
        growing.append(row)
    np.testing.assert_array_equal(growing.rows, rows)


def test_a_copy_of_rows_is_one_and_grows_on():
    rows = np.arange(10.0).reshape(5, 2)
    growing = Growing((2,))
    growing.append((7.0, 7.0))
    growing.replace(rows)
    growing.append((8.0, 9.0))
    growing.rows[0] = -1.0
    np.testing.assert_array_equal(growing.rows[1:], ((2, 3), (4, 5), (6, 7), (8, 9), (8, 9)))
    assert rows[0, 0] == 0.0


def test_stamps_keep_every_nanosecond():
    stamps = np.array((1_790_000_000_123_456_789, 1_790_000_000_123_456_790))
    growing = Growing(dtype=np.int64)
    growing.replace(stamps)
    growing.append(1_790_000_000_123_456_791)
    assert growing.rows.tolist() == [*stamps.tolist(), 1_790_000_000_123_456_791]
