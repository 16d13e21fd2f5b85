"""What the processes of a run left in their folders becomes one folder of results."""

import json

from runtime.supervision.run import collect


def test_latencies_of_monitor_and_viewer_are_in_one_place(tmp_path):
    for node, latency in (
        ("monitor", {"unit": "ms", "hops": {"whole": {"p50": 120}}, "scans": 10}),
        ("viewer", {"hops": {"screen": {"p50": 150}}}),
    ):
        (tmp_path / node).mkdir()
        (tmp_path / node / "latency.json").write_text(json.dumps(latency))
    metrics = collect(tmp_path, ["monitor", "viewer", "laser"], {"seed": 1}, {"robot": "robot"})
    expected = {"unit": "ms", "scans": 10, "hops": {"whole": {"p50": 120}, "screen": {"p50": 150}}}
    assert metrics["latency"] == expected
    assert json.loads((tmp_path / "metrics.json").read_text())["latency"] == expected
    assert not (tmp_path / "viewer").exists()
