"""What live nodes note of each scan, and the page that is made of it."""

import numpy as np

from processing.dpslam.config import DpSlamConfig
from processing.dpslam.population import Population
from runtime.formats.map_server import GridMap
from runtime.nodes.rows import (
    KEYS_COLUMNS,
    KEYS_FILE,
    MATCH_COLUMNS,
    MATCH_FILE,
    Rows,
    ancestors_of,
    write_particles,
)
from runtime.reports.folder import report_on
from runtime.reports.results import RunResult, save

STAMPS_NS = 1_790_000_000_000_000_400 + 100_000_000 * np.arange(20)


def people(particles=4):
    crowd = Population(DpSlamConfig(particles=particles), 1)
    for step in range(3):
        crowd.ancestry.extend(np.full((particles, 3), 1.0) * step + np.arange(particles)[:, None])
        if step == 1:
            crowd.ancestry.resample(np.array((0, 0, 2, 2), dtype=np.int32))
    return crowd


def test_particles_that_descend_from_one_share_its_number():
    old, middle, young = ancestors_of(people()).T
    assert old[0] == old[1] != old[2] == old[3]
    assert middle[0] == middle[1] != middle[2] == middle[3]
    assert len(set(young)) == 4


def test_a_table_goes_on_where_a_killed_process_stopped(tmp_path):
    for number in (1, 2):
        with Rows(tmp_path / "matcher", "t.csv", ("stamp_ns", "n")) as rows:
            rows.add(number, "a")
    assert (tmp_path / "t.csv").read_text() == "stamp_ns,n\n1,a\n2,a\n"


def test_without_results_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with Rows(None, "t.csv", ("n",)) as rows:
        rows.add(1)
    assert list(tmp_path.iterdir()) == []


def test_the_page_about_a_live_run_shows_match_and_particles(tmp_path):
    folder = tmp_path / "run"
    trajectory = np.column_stack((0.1 * np.arange(20), np.zeros(20), np.zeros(20)))
    grid = GridMap(np.zeros((20, 40), dtype=np.float32), 0.05, (0.0, 0.0))
    result = RunResult(
        config={},
        stamps_ns=STAMPS_NS,
        trajectory=trajectory,
        odometry=trajectory,
        grid=grid,
        path_m=trajectory[:, :2],
        metrics={},
        run={},
        caption="a run",
    )
    save(folder, result)
    with Rows(folder / "matcher", MATCH_FILE, MATCH_COLUMNS) as rows:
        for number, stamp in enumerate(STAMPS_NS[2:]):  # the first two are not known of
            rows.add(stamp, "DEGENERATE" if number >= 9 else "TRACKING", 0.8, 130, 1.5, "nan")
    with (folder / MATCH_FILE).open("a") as file:
        file.write("17900")  # a process that was killed while it wrote
    with Rows(folder / "mapper", KEYS_FILE, KEYS_COLUMNS) as rows:
        rows.add(STAMPS_NS[0], 50.0, 0)
        rows.add(STAMPS_NS[8], 20.0, 1)
    write_particles(folder / "mapper", people())
    assert report_on(folder, "robot")
    page = (folder / "report.html").read_text()
    assert "45.0 % DEGENERATE" in page
    assert "DEGENERATE from 1.1 to 1.9 s" in page
    assert "selected 1 times" in page
    assert "family tree" in page
