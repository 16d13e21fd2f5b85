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


def test_what_was_cut_off_costs_no_other_its_results(tmp_path):
    for node, file, text in (
        ("monitor", "latency.json", '{"unit": "ms", "ho'),
        ("mapper", "metrics.json", '{"scans": 7}'),
        ("mapper", "map.pgm", "P5"),
        ("recorder", "run.json", ""),
    ):
        (tmp_path / node).mkdir(exist_ok=True)
        (tmp_path / node / file).write_text(text)
    metrics = collect(tmp_path, ["monitor", "recorder", "mapper"], {"seed": 1}, {"robot": "robot"})
    assert metrics["scans"] == 7
    assert sorted(one.name for one in tmp_path.iterdir()) == [
        *("config.yaml", "map.pgm", "metrics.json", "run.json"),
    ]
