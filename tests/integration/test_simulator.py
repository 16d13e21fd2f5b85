"""The simulated world as the drivers meet it: two serial lines, a truth, and a scripted operator."""

import threading
import time

import numpy as np
import pytest

from drivers import world
from drivers.create.operators import Intent
from drivers.create.safety import State
from drivers.world.drive import simulate_scans
from runtime import messages
from runtime.bus.memory import MemoryBus
from runtime.clock import ManualClock
from runtime.nodes import base, laser, operator, simulator
from runtime.nodes.convert import pose_from_message, pose_to_message
from runtime.nodes.steering import input_of
from runtime.port import ListPort, Received
from runtime.process.checkpoint import Checkpoint
from runtime.process.node import BusPort

MS = 1_000_000


def wait(condition, within_s=20.0, what="it"):
    end = time.monotonic() + within_s
    while not (value := condition()):
        assert time.monotonic() < end, f"waited {within_s} s for {what}"
        time.sleep(0.01)
    return value


class Demo:
    """The nodes of the demo that touch the world, as threads on one bus."""

    def __init__(self, folder, **nodes):
        self.bus, self.folder, self.nodes = MemoryBus(), folder, nodes
        self.ports, self.threads, self.codes = {}, {}, {}
        self.listener = BusPort("listener", self.bus.join, subscribes=("truth", "scan", "diagnostics"))
        self.truth = self.listener.subscribe("truth", keep=4096)
        self.scans = self.listener.subscribe("scan", keep=4096)

    def __enter__(self):
        for name, (module, config) in self.nodes.items():
            port = BusPort(
                name,
                self.bus.join,
                subscribes=module.SUBSCRIBES,
                publishes=module.PUBLISHES,
                run_dir=self.folder,
            )
            self.ports[name] = port
            thread = threading.Thread(target=self._run, args=(name, module, port, config), daemon=True)
            self.threads[name] = thread
            thread.start()
            wait(lambda port=port: port._is_ready, what=name)
        return self

    def _run(self, name, module, port, config):
        self.codes[name] = module.run(port, config)

    def stop(self):
        for name in reversed(self.ports):
            self.ports[name].stop()
            self.threads[name].join(10.0)
            assert not self.threads[name].is_alive(), name

    def __exit__(self, *_):
        self.stop()
        for port in self.ports.values():
            port.close()


def test_the_operator_drives_the_robot_along_its_route_and_the_laser_sees_the_building(tmp_path):
    nodes = {
        "simulator": (simulator, simulator.Config()),
        "laser": (laser, laser.Config(path="laser")),
        "base": (base, base.Config(path="base")),
        "operator": (operator, operator.Config()),
    }
    building = world.demo_building()
    with Demo(tmp_path, **nodes) as demo:
        truths = []

        def driven():
            truths.extend(demo.truth.drain())
            poses = [pose_from_message(r.message.pose) for r in truths]
            return poses and np.hypot(*(poses[-1] - building.start)[:2]) > 1.2

        wait(driven, 60.0, "the robot to get going")
        scans = wait(lambda: demo.scans.drain(), what="scans")
        demo.stop()
        assert set(demo.codes.values()) == {0}
    # The ranges are those of the building from where the robot was when they were taken.
    stamps = np.array([messages.stamp_ns_of(r.message.header.stamp) for r in truths])
    poses = np.array([pose_from_message(r.message.pose) for r in truths])
    taken = [
        s.message for s in scans if stamps[0] < messages.stamp_ns_of(s.message.header.stamp) < stamps[-1]
    ]
    message = taken[len(taken) // 2]
    at_ns = messages.stamp_ns_of(message.header.stamp)
    pose = [np.interp(at_ns, stamps, column) for column in (poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2]))]
    bearings = message.angle_min + message.angle_increment * np.arange(len(message.ranges))
    expected = world.cast(building, pose[:2], pose[2] + bearings).ranges_m
    seen = np.isfinite(message.ranges)
    assert seen.mean() > 0.4
    assert np.median(np.abs(message.ranges[seen] - expected[seen])) < 0.03
    assert list(tmp_path.iterdir()) == []  # the links are gone


def test_truth_comes_ten_times_a_second_and_under_the_time_it_was_true(tmp_path):
    with Demo(tmp_path, simulator=(simulator, simulator.Config(building="room"))) as demo:
        got = []
        wait(lambda: (got.extend(demo.truth.drain()), len(got) > 20)[1], what="truths")
    stamps = np.array([messages.stamp_ns_of(r.message.header.stamp) for r in got])
    assert np.median(np.diff(stamps)) == pytest.approx(100 * MS, rel=0.2)
    assert all(0 <= r.received_ns - stamp < 1000 * MS for r, stamp in zip(got, stamps, strict=True))
    np.testing.assert_allclose(pose_from_message(got[-1].message.pose), world.room().start, atol=1e-9)


def test_a_simulator_that_was_killed_finds_the_robot_where_it_stood(tmp_path):
    config = simulator.Config(building="room")
    stood = world.room().start + np.array((0.5, -0.25, 1.0))
    Checkpoint(tmp_path / "simulator.checkpoint", 1, config).write(1, stood)
    with Demo(tmp_path, simulator=(simulator, config)) as demo:
        got = wait(demo.truth.drain, what="a truth")
        wait((tmp_path / "simulator.checkpoint").exists, what="its place to be kept")
        kept = Checkpoint(tmp_path / "simulator.checkpoint", 1, config).read()
    np.testing.assert_allclose(pose_from_message(got[0].message.pose), stood, atol=1e-9)
    np.testing.assert_allclose(kept, stood, atol=1e-9)
    assert list(tmp_path.iterdir()) == []  # its last word: the next run begins at the start


def test_every_building_can_be_simulated():
    assert set(simulator.BUILDINGS) == set(simulator.Config.__annotations__["building"].__args__)
    for name, make in simulator.BUILDINGS.items():
        building = make()
        robot = world.WheeledRobot(building)
        seen_mm = simulator.sight(building, robot, 1)(np.arange(682, dtype=np.int64) * 100_000)
        assert (seen_mm >= 20).mean() > 0.2, name
        assert operator.Config(building=name).building == name


def truth(pose):
    return "truth", messages.PoseStamped(
        header=messages.header(0, "map"), pose=pose_to_message(np.array(pose))
    )


def base_says(state):
    status = messages.DiagnosticStatus(
        level=0, name="robot/base", message="", hardware_id="", values=[messages.KeyValue("state", state)]
    )
    return "diagnostics", messages.DiagnosticArray(header=messages.header(0, ""), status=[status])


class Ticking(ManualClock):
    """A clock that moves 100 ms each time it is read."""

    def now_ns(self):
        self.advance(100 * MS)
        return super().now_ns()


def sent(*inputs):
    port = ListPort(*inputs, clock=Ticking())
    operator.run(port, operator.Config(building="room"))
    return [input_of(Received("cmd_vel", m)) for m in port.said("cmd_vel")]


def test_the_script_holds_the_stick_at_zero_before_it_arms():
    start = world.room().start
    said = sent(base_says("disarmed"), *[truth(start)] * 12)
    arms = [i for i, given in enumerate(said) if given.intent is Intent.ARM]
    assert arms
    assert arms[0] >= 2
    assert all((g.speed_mps, g.turn_rate_radps) == (0.0, 0.0) for g in said)


def test_the_script_drives_when_the_base_says_that_it_is_armed():
    said = sent(base_says(State.ARMED.value), *[truth(world.room().start)] * 3)
    assert said[0].speed_mps == pytest.approx(0.3, abs=0.01)
    assert said[0].intent is Intent.DRIVE
    assert said[-1].speed_mps == 0.0


@pytest.mark.parametrize("state", ["emergency stop", "arming", ""])
def test_the_script_lets_an_emergency_stop_stand(state):
    said = sent(base_says(state), *[truth(world.room().start)] * 20)
    assert {given.intent for given in said} == {Intent.DRIVE}
    assert {given.speed_mps for given in said} == {0.0}


def test_a_blind_script_says_nothing():
    assert [g.speed_mps for g in sent(base_says("armed"))] == [0.0]  # its last word, when it ends


def test_the_same_seed_drives_the_same_way():
    a, b = (list(simulate_scans(world.demo_building(), max_scans=5, seed=4)) for _ in range(2))
    assert all(np.array_equal(x[1], y[1], equal_nan=True) for x, y in zip(a, b, strict=True))
