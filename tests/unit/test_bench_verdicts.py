"""What the benches of hours and of blows call a fault, on runs that are written down here."""

import importlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"
SECOND_NS = 1_000_000_000


def bench(name):
    # A bench is run from its folder, and finds its neighbours there.
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCH)
        return importlib.import_module(name)


@pytest.fixture(scope="module", name="soak")
def fixture_soak():
    return bench("soak")


@pytest.fixture(scope="module", name="chaos")
def fixture_chaos():
    return bench("runtime_chaos")


ON_NEW_GROUND = (20.0,) * 6000 + (40.0,) * 30_000


def soaked(mb_per_h, maps_mb_per_h=0.0, files=30, ways_ms=(10.0,) * 36_000, complete=0):
    """An hour: what the mapper and its maps take, its files at the end, each way, when the map was whole."""
    samples = [
        (
            t,
            {"mapper": (300 + mb_per_h * t / 3600, 30 if t < 3500 else files, 8, maps_mb_per_h * t / 3600)},
            1000,
        )
        for t in range(0, 3600, 10)
    ]
    return SimpleNamespace(samples=samples, ways_ms=list(ways_ms), complete=complete)


@pytest.mark.parametrize(
    ("hour", "speed", "fault"),
    [
        ({"mb_per_h": 3.0}, 1.0, None),
        ({"mb_per_h": 25.0}, 1.0, "mapper GROWS"),
        ({"mb_per_h": 25.0}, 8.0, None),  # eight hours of the drive
        ({"mb_per_h": 25.0, "maps_mb_per_h": 24.0}, 1.0, None),
        ({"mb_per_h": 0.0, "files": 40}, 1.0, "mapper GROWS in files or threads"),
        ({"mb_per_h": 0.0, "ways_ms": np.linspace(40, 50, 36_000)}, 1.0, "p99 1.22 times"),
        ({"mb_per_h": 0.0, "ways_ms": np.linspace(40, 43, 36_000)}, 1.0, None),
        ({"mb_per_h": 0.0, "ways_ms": np.linspace(40, 80, 900)}, 1.0, None),  # too few to tell
        ({"mb_per_h": 0.0, "ways_ms": ON_NEW_GROUND}, 1.0, "p99 2.00 times"),
        ({"mb_per_h": 0.0, "ways_ms": ON_NEW_GROUND, "complete": 6000}, 1.0, None),
        ({"mb_per_h": 0.0, "complete": 36_000}, 1.0, None),  # it grew to the end
    ],
)
def test_an_hour_is_at_fault_if_memory_files_or_latency_grow(soak, capsys, hour, speed, fault):
    code = soak.report(soaked(**hour), {}, speed, 130, 1.0)
    assert code == int(fault is not None)
    told = capsys.readouterr().out
    assert f'"faults": [{f"{chr(34)}{fault}{chr(34)}" if fault else ""}]' in told


def rolling(chaos, until_s, commands_s=(), speed=0.3):
    """Two seconds of a robot that drives until a time and then stands, seen ten times a second."""
    stamps = np.arange(0, 2 * SECOND_NS + 1, SECOND_NS // 10)
    x = speed * np.minimum(stamps / SECOND_NS, until_s)
    places = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1)
    return SimpleNamespace(
        truth=lambda: (stamps, places),
        poses=lambda: (stamps, places),
        commanded_ns=[round(s * SECOND_NS) for s in commands_s],
    )


@pytest.mark.parametrize(
    ("until_s", "commands_s", "still_s", "faults"),
    [
        (1.22, (0.98,), 0.22, []),
        (1.35, (0.98,), 0.35, ["rolled on", "moved unbidden"]),
        (1.35, (0.98, 1.2), 0.35, ["rolled on"]),
        (0.5, (0.2,), None, []),
    ],
)
def test_wheels_that_roll_on_after_a_blow_are_a_fault(chaos, until_s, commands_s, still_s, faults):
    blow = chaos.Blow("operator", "SIGKILL", 0.9)
    chaos.judge(blow, rolling(chaos, until_s, commands_s), SECOND_NS, 19 * SECOND_NS // 10)
    assert blow.still_s == (None if still_s is None else pytest.approx(still_s, abs=0.005))
    assert blow.faults() == faults
    assert blow.leap_m == 0.0


def test_a_pose_that_leaps_where_the_robot_did_not_is_a_fault(chaos):
    watch = rolling(chaos, 2.0, np.arange(0, 2, 0.1))
    stamps, places = watch.truth()
    elsewhere = places + np.where(stamps > 1.5 * SECOND_NS, 0.5, 0.0)[:, None]
    watch.poses = lambda: (stamps, elsewhere)
    blow = chaos.Blow("mapper", "SIGKILL", 0.9)
    chaos.judge(blow, watch, SECOND_NS, 19 * SECOND_NS // 10)
    assert blow.leap_m == pytest.approx(np.hypot(0.53, 0.5) - 0.03, abs=1e-6)
    assert blow.faults() == ["leap of 0.70 m"]


def test_what_comes_late_or_not_at_all_or_without_its_map_is_a_fault(chaos):
    assert chaos.Blow("mapper", "SIGKILL", 2.5, known_share=0.5).faults() == ["late", "map lost"]
    assert chaos.Blow("mapper", "SIGKILL", 1.5, known_share=0.995).faults() == []
    assert chaos.Blow("hub", "SIGSTOP", None).faults() == ["not back"]
