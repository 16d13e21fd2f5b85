"""A recorder that is killed at any moment leaves everything that it had flushed."""

import pytest

from tests.bench import record_kill


@pytest.mark.parametrize(("after_s", "split_s"), [(0.0, 0.0), (0.6, 0.0), (1.1, 1.0), (1.7, 0.0), (2.3, 1.0)])
def test_what_was_flushed_before_a_kill_is_read_back(tmp_path, after_s, split_s):
    result = record_kill.kill_once(tmp_path, after_s, period_s=0.02, split_s=split_s)
    assert result["flushed_and_lost"] == 0
    assert result["out_of_order"] == 0
    assert result["read"] <= result["sent"]
    assert result["sent"] >= 1
