"""The public logs, whole: as many scans as they are known to hold, with their own stamps and rate."""

from pathlib import Path

import numpy as np
import pytest

from runtime.formats.logs import open_log

DATA = Path(__file__).parents[3] / "shared" / "data"

pytestmark = pytest.mark.data


def opened(name):
    if not (DATA / name).is_file():
        pytest.skip(f"needs {name} in ../shared/data")
    return open_log(DATA / name)


@pytest.mark.parametrize(
    ("name", "scans", "beams", "period_s"),
    [
        ("exp1.dat", 756, 682, 0.0988),
        ("exp2.dat", 641, 682, 0.0988),
        ("ccny_urg.bag", 360, 681, 0.1),
        ("intel.clf.bz2", 13631, 180, 0.1975),
        ("fr079.clf.bz2", 4934, 360, 0.2145),
        ("wean1.log", 713, 180, 0.188),
    ],
)
def test_every_scan_of_a_public_log_is_read(name, scans, beams, period_s):
    log = opened(name)
    rows = [record.ranges_m for record in log]
    assert len(rows) == len(log) == scans
    assert {len(row) for row in rows} == {beams} == {log.geometry.count}
    assert log.geometry.period_s == pytest.approx(period_s, rel=0.01)
    table = np.stack(rows)
    distances = table[np.isfinite(table)]
    assert distances.min() >= np.float32(0.02)
    assert distances.max() < log.geometry.range_max_m


def test_intel_keeps_its_631_steps_backwards():
    log = opened("intel.clf.bz2")
    assert np.count_nonzero(np.diff(log.stamps_ns) < 0) == 631
    assert any("backwards 631 times" in notice for notice in log.notices)


def test_more_than_half_of_the_rays_of_exp1_say_nothing():
    table = np.stack([record.ranges_m for record in opened("exp1.dat")])
    assert 0.53 < np.isnan(table).mean() < 0.60
