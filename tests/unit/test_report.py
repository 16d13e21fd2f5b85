import base64
import html.parser
import re

import numpy as np
import pytest

from processing.odometry import SHAKEN
from runtime.reports import chart
from runtime.reports.report import (
    _COLOURS,
    DOUBTED,
    DOUBTED_M,
    STATES,
    ReportData,
    judged,
    page,
    write_report,
)
from runtime.reports.tables import flat


class Reader(html.parser.HTMLParser):
    """Checks that every element that opens closes, and keeps text and addresses."""

    VOID = ("meta", "img", "br")

    def __init__(self):
        super().__init__()
        self.open, self.text, self.addresses = [], [], []

    def handle_starttag(self, tag, attrs):
        self.addresses += [value for name, value in attrs if name in ("src", "href")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def read(text):
    reader = Reader()
    reader.feed(text)
    assert reader.open == []
    return reader


def run(count=200, **changes):
    t = np.arange(count)
    values = {
        "title": "a <drive> & more",
        "picture": b"a picture",
        "known_m2": 6.0,
        "stamps_ns": 1_000_000_000 + 100_000_000 * t,
        "map_t_laser": np.column_stack((0.01 * t, np.ones(count), np.zeros(count))),
        "states": ["TRACKING"] * count,
        "score": np.full(count, 0.9),
        "points": np.full(count, 130),
        "sigma_m": np.full((count, 2), 0.004),
        "n_eff": np.full(count, 70.0),
        "resampled": t % 50 == 0,
        "particles": np.zeros((10, 3)),
        "ancestors": np.stack([np.minimum(np.arange(19), 4) * (p // 2) for p in range(10)]).astype(np.int16),
        "facts": {"version": "0.1.0"},
        "config": "slam: {}\n",
    }
    return ReportData(**(values | changes))


def test_the_page_is_whole_and_needs_nothing_from_elsewhere():
    reader = read(page(run()))
    assert reader.addresses
    assert all(address.startswith("data:image/png;base64,") for address in reader.addresses)
    assert "script" not in page(run())


def test_the_same_run_gives_the_same_bytes(tmp_path):
    for name in ("a.html", "b.html"):
        write_report(tmp_path / name, run())
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.html", "b.html"]


def test_the_first_line_says_how_it_went():
    text = " ".join(read(page(run(states=["TRACKING"] * 150 + ["DEGENERATE"] * 50))).text)
    assert "200 scans in 20 s, 2.0 m driven, 6 m² mapped; 75.0 % TRACKING, 25.0 % DEGENERATE" in text


def test_where_the_match_did_not_hold_is_listed_the_longest_first():
    states = ["TRACKING"] * 200
    states[20:23] = ["LOST"] * 3
    states[100:150] = ["DEGENERATE"] * 50
    text = " ".join(read(page(run(states=states))).text)
    first = text.index("DEGENERATE from 10.0 to 14.9 s, at (1.0, 1.0) m")
    assert first < text.index("LOST from 2.0 to 2.2 s, at (0.2, 1.0) m")


def test_a_place_just_left_of_zero_has_no_minus_before_its_zero():
    poses = np.tile((-0.004, -0.26, 0.0), (200, 1))
    text = " ".join(read(page(run(map_t_laser=poses, states=["LOST"] * 200))).text)
    assert "at (0.0, -0.3) m" in text


def doubting(*spans, count=200):
    sigma_m = np.full((count, 2), 0.003)
    for begin, end, value in spans:
        sigma_m[begin:end] = value
    return sigma_m


def test_where_the_match_was_doubted_is_counted_marked_and_listed():
    sigma_m = doubting((0, 1, np.nan), (60, 70, np.nan), (70, 100, 0.051))
    text = page(run(sigma_m=sigma_m))
    words = " ".join(read(text).text)
    assert "80.0 % TRACKING, 20.0 % doubted" in words
    assert "doubted from 6.0 to 9.9 s, at (0.6, 1.0) m" in words
    assert words.count(" s, at (") == 1
    assert text.count(f'height="16" fill="{_COLOURS[DOUBTED]}"') == 1


def test_a_track_that_begins_a_corridor_and_a_loss_are_no_doubts():
    states = np.array(["TRACKING"] * 200)
    states[50:60], states[100:110] = "LOST", "DEGENERATE"
    sigma_m = doubting((0, 1, np.nan), (50, 61, np.nan), (100, 110, 0.2))
    assert judged(run(states=states.tolist(), sigma_m=sigma_m)).tolist() == states.tolist()


def test_doubt_is_what_the_matcher_says_of_a_shaken_scan():
    assert pytest.approx(DOUBTED_M) == SHAKEN[:2].min() == SHAKEN[:2].max()


def test_a_plateau_of_doubt_leaves_the_usual_millimetres_to_be_seen():
    sigma_mm = 1e3 * doubting((60, 100, 0.05))[:, 0]
    x = np.arange(200.0)
    (line,) = polyline(chart.decades(x, {"v": sigma_mm}, "v"))
    heights = {round(y) for _, y in line}
    assert max(heights) - min(heights) > 60  # 3 mm and 50 mm: 1.2 of two decades
    assert max(heights) < 128 - 20  # and 3 mm lie well above the foot
    marks = re.findall(r'text-anchor="end"[^>]*>([\d.]+)<', chart.decades(x, {"v": sigma_mm}, "v"))
    assert marks == ["1", "10", "100"]


@pytest.mark.parametrize("value", [0.0, np.nan, 1e-9, 1.0])
def test_a_logarithmic_scale_takes_what_has_no_logarithm(value):
    series = {"v": np.full(50, value), "w": np.r_[np.zeros(49), 5.0]}
    svg = chart.decades(np.arange(50.0), series, "v")
    assert "nan" not in svg
    assert len(re.findall(r'text-anchor="end"', svg)) <= 6 + 1


def test_values_in_tables_are_words_for_people():
    facts = {
        "host": {"machine": "x86_64", "cores": 2},
        "topic": None,
        "known": 40.07500000000001,
        "laser_in_base": [0.1, 0.0],
        "interrupted": True,
        "notices": [],
    }
    assert list(flat(facts)) == [
        ("host, machine", "x86_64"),
        ("host, cores", "2"),
        ("known", "40.08"),
        ("laser_in_base", "0.1, 0"),
        ("interrupted", "yes"),
        ("notices", "none"),
    ]


def test_a_page_fits_a_phone():
    text = page(run())
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in text
    assert "overflow-wrap: anywhere" in text


def test_text_from_outside_is_text_and_no_markup():
    text = page(run(notices=["<script>alert(1)</script>"], facts={"input": "<b>"}))
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
    assert "<title>a &lt;drive&gt; &amp; more</title>" in text


@pytest.mark.parametrize("count", [0, 1])
def test_a_run_of_hardly_a_scan_is_a_page_too(count):
    assert "Map" in read(page(run(count, resampled=np.zeros(count, dtype=bool)))).text


def test_a_run_without_the_rest_is_map_and_states_alone():
    rest = ("score", "points", "sigma_m", "n_eff", "resampled", "particles", "ancestors")
    reader = read(page(run(**dict.fromkeys(rest))))
    assert "Map" in reader.text
    assert "Particles" not in reader.text


def test_a_day_of_scans_stays_a_small_page():
    count = 100_000
    rng = np.random.default_rng(1)
    states = rng.choice(STATES, count).tolist()
    text = page(run(count, states=states, score=rng.random(count), map_t_laser=rng.normal(0, 1, (count, 3))))
    assert len(text) < 1_000_000


def test_an_array_of_another_length_is_named():
    with pytest.raises(ValueError, match="score has 3 entries, must have 200"):
        run(score=np.zeros(3))


def test_stamps_that_go_backwards_do_not_draw_backwards():
    stamps_ns = 1_000_000_000 + 100_000_000 * np.arange(200)
    stamps_ns[100:110] -= 3_000_000_000
    text = page(run(stamps_ns=stamps_ns))
    for points in re.findall(r'<polyline[^>]*points="([^"]*)"', text):
        x = [float(pair.split(",")[0]) for pair in points.split()]
        assert x == sorted(x)


def test_latency_and_losses_are_in_the_page_when_there_were_any():
    latency = {"match": {"p50": 3.14, "p99": 9.0, "max": 40.0}}
    text = " ".join(read(page(run(latency_ms=latency, counts={"scan.missed": 7}))).text)
    assert "match 3.1 9.0 40.0 scan published to odom published" in text
    assert "scan.missed 7" in text


def polyline(svg):
    return [
        [tuple(map(float, pair.split(","))) for pair in points.split()]
        for points in re.findall(r'points="([^"]*)"', svg)
    ]


def test_the_first_scan_has_no_score_that_could_be_low():
    score = np.full(200, 0.9)
    score[0] = 0.0
    alone = dict.fromkeys(("points", "sigma_m", "n_eff", "resampled", "ancestors"))
    (line,) = polyline(page(run(score=score, **alone)))
    assert max(y for _, y in line) < 60  # far above the foot, which is at 128


@pytest.mark.parametrize(("reach_m", "bar"), [(0.004, "1 mm"), (0.05, "10 mm"), (2.0, "1 m")])
def test_a_cloud_of_particles_fills_its_panel_whatever_its_size(reach_m, bar):
    poses = np.array([(-reach_m, 0.0, 0.0), (reach_m, 0.0, 0.0), (-reach_m, reach_m, 1.0)])
    svg = chart.cloud(poses + np.array((5.0, 3.0, 0.0)), "p")
    across = [float(x) for x in re.findall(r'cx="([\d.]+)"', svg)]
    assert max(across) - min(across) >= 0.5 * 320
    assert min(across) > 8.0
    assert max(across) + 12 < 320
    assert f">{bar}</text>" in svg


def test_a_single_peak_among_many_values_is_drawn():
    value = np.zeros(100_000)
    value[54_321] = 1.0
    (line,) = polyline(chart.lines(np.arange(100_000.0), {"v": value}, "v", low=0.0, high=1.0))
    assert len(line) <= 1200
    assert min(y for _, y in line) == pytest.approx(26.0)  # the top of the frame


def test_a_gap_stays_a_gap():
    value = np.ones(100)
    value[40:60] = np.nan
    left, right = polyline(chart.lines(np.arange(100.0), {"v": value}, "v"))
    assert left[-1][0] < right[0][0] - 100


def test_a_single_lost_scan_of_a_long_run_is_seen():
    states = ["TRACKING"] * 100_000
    states[50_000] = "LOST"
    svg = chart.strip(np.arange(100_000.0), states, {"TRACKING": "#0f0", "LOST": "#f00"})
    (width,) = re.findall(r'width="(\d+)" height="16" fill="#f00"', svg)
    assert int(width) >= 1


def test_a_run_that_was_live_has_its_page_made_of_its_files(tmp_path):
    from runtime.formats.map_server import GridMap
    from runtime.reports.folder import report_on
    from runtime.reports.results import RunResult, save

    folder = tmp_path / "run"
    data = run(50)
    probability = np.full((40, 60), 0.4, dtype=np.float32)
    probability[5:30], probability[:5] = 0.1, np.nan
    grid = GridMap(probability, 0.05, (0.0, 0.0))
    hops = {"unit": "ms", "hops": {"map": {"count": 9, "p50": 2.5, "p99": 7.0, "max": 8.0}}, "late": 3}
    processes = {"matcher": {"restarts": 2, "reasons": ["killed by signal 9"]}, "mapper": {"restarts": 0}}
    events = ["1700 matcher: ended with exit code -9, starts again", "1701 mapper: ready"]
    result = RunResult(
        config={"a": 1},
        stamps_ns=data.stamps_ns,
        trajectory=data.map_t_laser,
        odometry=data.map_t_laser,
        grid=grid,
        path_m=data.map_t_laser[:, :2],
        metrics={"latency": hops, "way_m": 0.5, "known_m2": 40.075},
        run={"seed": 7, "processes": processes, "events": events},
    )
    save(folder, result)
    assert report_on(folder, "demo")
    page_ = read((folder / "report.html").read_text())
    (address,) = page_.addresses
    picture = base64.b64decode(address.removeprefix("data:image/png;base64,"))
    assert picture == (folder / "map.png").read_bytes()
    text = " ".join(page_.text)
    assert "map 2.5 7.0 8.0" in text
    assert "late 3" in text
    assert "matcher, started again 2: killed by signal 9" in text
    assert "matcher: ended with exit code -9" in text
    assert "mapper: ready" not in text
    assert "seed 7" in text
    assert "40 m² mapped" in text
    assert "known_m2" not in text
    assert not report_on(tmp_path, "nothing")
