"""The laser node on an emulated sensor: what it publishes, under which stamps, and what it says of itself."""

import math

import numpy as np
import pytest

from drivers.errors import PortMissingError
from drivers.urg04lx import faults
from drivers.urg04lx.emulator import PERIOD_NS, Emulator
from drivers.urg04lx.model import Mode
from runtime.clock import Clock
from runtime.errors import ConfigError
from runtime.nodes import laser
from runtime.nodes.convert import scan_from_message
from runtime.nodes.laser import Config
from runtime.port import ListPort

SPEED = 4.0


class EmulatorClock(Clock):
    """The clock of an emulated host."""

    def __init__(self, emulator):
        super().__init__(0)
        self._emulator = emulator

    def now_ns(self):
        return self._emulator.now_ns()


def run(emulator, scans, **config):
    port = ListPort(clock=EmulatorClock(emulator), stop_after=scans)
    assert laser.run(port, Config(path=emulator.port, **config)) == 0
    return port


def codes_and_distances(ray_times_ns):
    """Every error code, distances up to beyond the maximum, at known rays."""
    seen = np.full(len(ray_times_ns), 1500, dtype=np.int32)
    seen[:20] = np.arange(20)
    seen[20:26] = (20, 4095, 4096, 5600, 5601, 6000)
    return seen


def test_a_scan_carries_geometry_and_meaning_of_every_value():
    with Emulator(codes_and_distances, speed=SPEED) as emulator:
        port = run(emulator, 5)
    message = port.said("scan")[-1]
    assert message.header.frame_id == "laser"
    assert len(message.ranges) == 682
    assert message.angle_min == pytest.approx(math.radians((44 - 384) * 360 / 1024))
    assert message.angle_max == pytest.approx(math.radians((725 - 384) * 360 / 1024))
    assert message.time_increment == pytest.approx(0.1 / 1024)
    assert message.scan_time == pytest.approx(0.1)
    assert (message.range_min, message.range_max) == (pytest.approx(0.02), pytest.approx(5.6))
    assert np.isnan(message.ranges[:20]).all()
    assert message.ranges[20:24] == pytest.approx([0.02, 4.095, 4.096, 5.6])
    assert np.isnan(message.ranges[24:26]).all()
    assert message.ranges[26:] == pytest.approx(np.full(656, 1.5))
    assert port.is_ready
    assert {f"code_{code}" for code in range(20)} <= port.counters.keys()
    assert port.counters["beyond"] >= 5 * 2
    assert port.counters["impossible"] >= 5 * 2
    assert scan_from_message(message).beams.count == 682


def test_a_stamp_is_the_time_of_the_first_ray():
    def errors_ms():
        with Emulator(speed=1.0) as emulator:
            port = run(emulator, 12)
            first_rays = [step_0_ns + 44 * PERIOD_NS // 1024 for _, step_0_ns in emulator.sweeps]
        stamps = [m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for m in port.said("scan")]
        assert len(stamps) == 12
        return (np.array(stamps) - first_rays[:12]) / 1e6

    # No stamp is early; how late the first ones are is up to the machine, which may need another go.
    goes = [errors_ms()]
    while np.abs(goes[-1]).max() > 20.0 and len(goes) < 8:
        goes.append(errors_ms())
    assert min(go.min() for go in goes) > -20.0
    assert goes[-1].max() < 20.0


def test_a_moving_sensor_gives_each_ray_its_own_time():
    speed_mm_s = 500.0
    began_ns = []

    def approaching_wall(ray_times_ns):
        began_ns.append(ray_times_ns[0])
        return np.rint(4000 - speed_mm_s * (ray_times_ns - began_ns[0]) / 1e9).astype(np.int32)

    with Emulator(approaching_wall, speed=1.0) as emulator:
        port = run(emulator, 6)
        true_ns = emulator.sweeps[5][1] + 44 * PERIOD_NS // 1024
    scan = scan_from_message(port.said("scan")[-1])
    times_s = (scan.stamp_ns - began_ns[0]) / 1e9 + scan.beams.time_increment_s * np.arange(682)
    error_mm = scan.ranges_m * 1000 - (4000 - speed_mm_s * times_s)
    # Within the scan: to the rounding of a millimetre. On the whole: just as much as the stamp is wrong.
    assert np.ptp(error_mm) < 2.0
    assert error_mm.mean() == pytest.approx(speed_mm_s * (scan.stamp_ns - true_ns) / 1e9, abs=1.0)


def test_a_sensor_that_hangs_upside_down_has_its_rays_reversed():
    with Emulator(speed=SPEED) as emulator:
        message = run(emulator, 2, upside_down=True).said("scan")[-1]
    assert message.angle_min == pytest.approx(math.radians(119.53125))
    assert message.angle_increment == pytest.approx(-math.radians(360 / 1024))
    assert message.time_increment > 0


def test_groups_and_a_part_of_the_view_are_published_as_such():
    with Emulator(speed=SPEED) as emulator:
        port = run(emulator, 2, cluster=2, first_step=128, last_step=639, wide=False, skip=1)
        assert b"MS0128063902100" in emulator.requests
    message = port.said("scan")[-1]
    assert len(message.ranges) == 256
    assert message.scan_time == pytest.approx(0.2)
    assert message.angle_min == pytest.approx(math.radians((128.5 - 384) * 360 / 1024))


def test_damaged_scans_are_counted_and_published_as_counters():
    with Emulator(speed=SPEED) as emulator:
        emulator.spoil(faults.flip(300), 3, every=4)
        port = run(emulator, 20)
    assert port.counters["damaged_sum"] == 3
    assert 3 <= port.counters["missed_scans"] <= 3 + emulator.dropped
    assert port.counters["scans"] >= 20


def test_a_covered_window_is_reported_after_five_seconds():
    def dark(ray_times_ns):
        return np.zeros(len(ray_times_ns), dtype=np.int32)

    with Emulator(dark, speed=SPEED * 2) as emulator:
        port = run(emulator, 75)
    assert ("warn", "nearly all rays return nothing; is the window covered?") in [r[:2] for r in port.reports]


def test_looking_for_the_sensor_at_the_start_is_no_warning():
    with Emulator(speed=SPEED) as emulator:
        port = run(emulator, 5)
    assert {level for level, _, _ in port.reports} == {"ok"}


def test_silence_is_reported_and_the_end_of_it_too():
    with Emulator(speed=SPEED) as emulator:
        port = _StoppingPort(emulator)
        laser.run(port, Config(path=emulator.port))
    levels = [level for level, _, _ in port.reports]
    assert "warn" in levels
    assert levels[-1] == "ok"
    ill = [text for level, text, _ in port.reports if level == "warn" and "no scan for" in text]
    assert ill


class _StoppingPort(ListPort):
    """Silences the sensor after five scans, stops when scans come again."""

    def __init__(self, emulator):
        super().__init__(clock=EmulatorClock(emulator), stop_after=40)
        self._emulator = emulator

    def publish(self, topic, message):
        super().publish(topic, message)
        if len(self.published) == 5:
            self._emulator.silence(0.8)


def test_a_port_that_does_not_exist_is_one_clear_error():
    port = ListPort(clock=Clock(0), stop_after=1)
    with pytest.raises(PortMissingError, match="/dev/ttyNOWHERE: no such port"):
        laser.run(port, Config(path="/dev/ttyNOWHERE", patience_s=0.0))
    assert not port.is_ready


def test_steps_the_sensor_does_not_have_are_an_error_of_configuration():
    with Emulator(speed=SPEED) as emulator, pytest.raises(ConfigError, match=r"steps = 0 \.\. 725"):
        run(emulator, 1, first_step=0)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"baud": 115_200}, "baud = 115200"),
        ({"cluster": 0}, "cluster = 0"),
        ({"patience_s": -1}, "patience_s = -1"),
        ({"latency_ms": -1.0}, "latency_ms = -1"),
    ],
)
def test_a_wrong_configuration_names_the_field(wrong, named):
    with pytest.raises(ValueError, match=named):
        Config(**wrong)


def test_the_laser_is_off_when_the_node_has_ended():
    with Emulator(speed=SPEED) as emulator:
        run(emulator, 3)
        assert emulator.sensor.mode is Mode.IDLE
        assert emulator.requests[-1] == b"QT"
