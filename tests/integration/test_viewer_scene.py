"""From messages to drawings: what is drawn where, and how often."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from runtime import messages
from runtime.nodes import viewer_scene, viewer_shapes
from runtime.nodes.convert import transform_to_message
from runtime.nodes.viewing.scene import Scene

_spec = importlib.util.spec_from_file_location("viewer_story", Path(__file__).with_name("viewer_story.py"))
story = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(story)


class Canvas:
    """Keeps what was drawn, as (name, arguments) with the time of each."""

    def __init__(self):
        self.drawn = []
        self.stamp_ns = None

    def at(self, stamp_ns):
        self.stamp_ns = stamp_ns

    def __getattr__(self, name):
        return lambda *arguments: self.drawn.append((name, self.stamp_ns, arguments))

    def all(self, name):
        return [arguments for drawn, _, arguments in self.drawn if drawn == name]

    def last(self, name):
        return self.all(name)[-1]


@pytest.fixture
def canvas():
    return Canvas()


@pytest.fixture
def scene(canvas):
    return Scene("robot", lambda kind, draw: draw(canvas))


def take(scene, topic, message, number=0, after_ms=110):
    scene.take(story.received(topic, message, story.stamp(number) + after_ms * 1_000_000))


def test_a_scan_is_drawn_at_the_pose_of_its_own_stamp(scene, canvas):
    for number in range(3):
        take(scene, "scan", story.scan(number), number)
        take(scene, "match_points", story.cloud(number), number)
    take(scene, "odom", story.odom(2), 2)
    rays, hits = canvas.last("scan")
    np.testing.assert_allclose(np.hypot(*(rays - [0.2, 0.0]).T), 2.0, atol=1e-5)
    np.testing.assert_allclose(hits, [[2.2, 0.0], [0.2, 2.0]], atol=1e-6)
    assert [stamp for name, stamp, _ in canvas.drawn if name == "scan"] == [story.stamp(2)]


def test_the_mapper_s_correction_moves_what_is_drawn(scene, canvas):
    correction = transform_to_message(story.stamp(0), "map", "odom", np.array((0.0, 5.0, 0.0)))
    take(scene, "tf", messages.TFMessage(transforms=[correction]))
    take(scene, "scan", story.scan(0))
    take(scene, "match_points", story.cloud(0))
    take(scene, "odom", story.odom(0))
    np.testing.assert_allclose(canvas.last("laser")[0], [0.0, 5.0, 0.0], atol=1e-9)


def test_a_scan_whose_points_never_come_is_drawn_without_them(scene, canvas):
    for number in (0, 1):
        take(scene, "scan", story.scan(number), number)
        take(scene, "odom", story.odom(number), number)
    rays, hits = canvas.last("scan")
    assert len(rays) == story.BEAMS.count
    assert len(hits) == 0


def test_scans_without_a_match_are_forgotten_in_bounded_memory(scene):
    for number in range(1000):
        take(scene, "scan", story.scan(number), number)
    assert len(scene._sweeps) == viewer_scene.SWEEPS_HELD


def test_forty_scans_a_second_are_drawn_ten_times_a_second(scene, canvas):
    for number in range(80):
        shift_ns = number * 25_000_000
        for topic, message in (
            ("scan", story.scan(0)),
            ("match_points", story.cloud(0)),
            ("odom", story.odom(0)),
        ):
            message.header.stamp = messages.time_of(story.BEGIN_NS + shift_ns)
            scene.take(story.received(topic, message, story.BEGIN_NS + shift_ns))
    assert 19 <= len(canvas.all("scan")) <= 22


def test_the_map_is_drawn_as_it_lies_and_not_more_often_than_its_period(scene, canvas):
    for number in range(40):
        take(scene, "map", story.grid(number), number)
    cells, resolution_m, origin_m = canvas.last("grid")
    np.testing.assert_array_equal(cells, story.room())
    assert resolution_m == pytest.approx(story.CELL_M)
    assert origin_m == (-2.0, -3.0)
    assert len(canvas.all("grid")) == 2


def test_an_update_changes_its_rectangle_alone(scene, canvas):
    take(scene, "map", story.grid(0))
    cells = story.room()
    rows, cols = np.s_[50:53], np.s_[60:64]
    cells[rows, cols] = 77
    update = messages.OccupancyGridUpdate(
        header=messages.header(story.stamp(30), "map"),
        x=60, y=50, width=4, height=3, data=np.full(12, 77, dtype=np.int8),
    )  # fmt: skip
    take(scene, "map_updates", update, 30)
    np.testing.assert_array_equal(canvas.last("grid")[0], cells)


def test_an_update_outside_the_map_is_counted_and_changes_nothing(scene, canvas):
    take(scene, "map", story.grid(0))
    update = messages.OccupancyGridUpdate(
        header=messages.header(story.stamp(30), "map"),
        x=199, y=50, width=4, height=3, data=np.full(12, 77, dtype=np.int8),
    )  # fmt: skip
    take(scene, "map_updates", update, 30)
    assert scene.refused == 1
    assert len(canvas.all("grid")) == 1


def test_a_huge_map_is_sent_smaller_and_keeps_its_walls(scene, canvas):
    cells = np.zeros((3000, 2000), dtype=np.int8)
    cells[:, 700] = 100
    take(scene, "map", story.grid(0, cells))
    small, resolution_m, _ = canvas.last("grid")
    assert small.size <= viewer_scene.MAP_CELLS_MAX
    assert resolution_m == pytest.approx(3 * story.CELL_M)
    assert (small.max(axis=1) == 100).all()


def test_a_long_trajectory_is_thinned_and_keeps_its_newest_pose(scene, canvas):
    take(scene, "trajectory", story.path(2 * viewer_scene.PATH_POINTS_MAX + 1))
    points = canvas.last("path")[0]
    assert len(points) <= viewer_scene.PATH_POINTS_MAX
    np.testing.assert_allclose(points[-1], [0.1 * (2 * viewer_scene.PATH_POINTS_MAX + 1), 0.0])


def test_poses_lengthen_the_path_between_trajectories_without_end_or_growth(scene, canvas):
    for number in range(3 * viewer_scene.PATH_POINTS_MAX):
        take(scene, "pose", story.pose(number), number)
    assert len(scene._path) <= 2 * viewer_scene.PATH_POINTS_MAX + 1
    assert canvas.last("path")[0][-1, 0] > 0.099 * 3 * viewer_scene.PATH_POINTS_MAX - 1.0


def test_the_ellipse_holds_ninety_five_of_a_hundred():
    rng = np.random.default_rng(1)
    covariance = np.array(((0.04, 0.018), (0.018, 0.01)))
    outline = viewer_shapes.outline(np.array((1.0, 2.0, 0.0)), covariance) - (1.0, 2.0)
    inverse = np.linalg.inv(covariance)
    radius = np.einsum("ni,ij,nj->n", outline, inverse, outline)
    drawn = rng.multivariate_normal((0, 0), covariance, 20_000)
    share = (np.einsum("ni,ij,nj->n", drawn, inverse, drawn) <= radius.mean()).mean()
    assert share == pytest.approx(0.95, abs=0.01)
    np.testing.assert_allclose(radius, radius[0], rtol=1e-6)


def test_the_unseen_direction_is_drawn_only_while_the_match_does_not_hold(scene, canvas):
    def step(number):
        take(scene, "scan", story.scan(number), number)
        take(scene, "match_points", story.cloud(number), number)
        take(scene, "odom", story.odom(number, variances=(1e-6, 1e-2, 1e-6)), number)
        return canvas.last("uncertainty")[1]

    assert len(step(0)) == 0
    take(scene, "diagnostics", story.diagnostics(1, "matcher", state="DEGENERATE"), 1)
    ends = step(1)
    np.testing.assert_allclose(np.abs(ends[:, 1]), viewer_shapes.BLIND_M)  # along y, which it knows least
    np.testing.assert_allclose(ends[:, 0], 0.1, atol=1e-9)
    take(scene, "diagnostics", story.diagnostics(20, "matcher", state="TRACKING"), 20)
    assert len(step(20)) == 0


def test_the_state_is_said_in_words(scene, canvas):
    take(scene, "diagnostics", story.diagnostics(0, "matcher", state="LOST"))
    text = canvas.last("words")[0]
    assert text.startswith("# LOST")
    assert "Drive slowly" in text
    assert canvas.last("state") == ("state/tracking", "LOST")


def test_before_the_first_match_the_state_is_starting(scene, canvas):
    take(scene, "diagnostics", story.diagnostics(0, "supervisor"))
    assert canvas.last("state") == ("state/tracking", "STARTING")
    assert canvas.last("words")[0].startswith("# STARTING")
    take(scene, "diagnostics", story.diagnostics(10, "matcher", state="TRACKING"), 10)
    assert canvas.last("state") == ("state/tracking", "TRACKING")


def test_a_warning_is_noted_once_and_its_end_too(scene, canvas):
    for number in range(10):
        take(scene, "diagnostics", story.diagnostics(number, "laser", 1, "rate is 8 Hz"), number)
    take(scene, "diagnostics", story.diagnostics(11, "laser", 0, "running"), 11)
    assert canvas.all("note") == [("warn", "laser: rate is 8 Hz"), ("ok", "laser: running")]


def test_another_robot_s_words_are_not_ours(scene, canvas):
    message = story.diagnostics(0, "matcher", state="LOST")
    message.status[0].name = "other/matcher"
    take(scene, "diagnostics", message)
    assert scene._vitals == {}


def test_latency_is_from_the_first_ray_to_the_pose_on_the_wire(scene, canvas):
    take(scene, "pose", story.pose(0), 0, after_ms=137)
    assert ("latency/scan_to_pose", pytest.approx(137.0)) in canvas.all("number")


def test_what_is_drawn_is_told_with_its_stamp_and_what_was_dropped_is_not(canvas):
    told, waiting = [], []
    scene = Scene("robot", lambda kind, draw: waiting.append((kind, draw)), told.append)
    for number in range(2):
        for topic, message in (
            ("scan", story.scan(number)),
            ("match_points", story.cloud(number)),
            ("odom", story.odom(number)),
        ):
            take(scene, topic, message, number)
    assert told == []
    draws = [draw for kind, draw in waiting if kind == "scan"]
    draws[1](canvas)
    assert told == [story.stamp(1)]


def test_bumps_and_battery_reach_the_screen(scene, canvas):
    take(scene, "battery", story.battery(0.5))
    for bits in (0, 1, 1, 4, 0):
        take(scene, "bumper", story.bumper(bits))
    assert canvas.last("number") == ("base/battery", 50.0)
    states = [word for path, word in canvas.all("state") if path == "state/bumper"]
    assert states == ["bumped", "wheel drop", "free"]


def test_messages_that_cannot_be_drawn_are_counted(scene):
    bad_scan = story.scan(0)
    bad_scan.range_max = 0.0
    bad_cloud = story.cloud(0)
    bad_cloud.data = bad_cloud.data[:7]
    bad_map = story.grid(0)
    bad_map.info.height = 7
    for topic, message in (("scan", bad_scan), ("match_points", bad_cloud), ("map", bad_map)):
        take(scene, topic, message)
    assert scene.refused == 3


def test_a_late_viewer_gets_what_changes_seldom_once_more(scene, canvas):
    take(scene, "map", story.grid(0))
    take(scene, "trajectory", story.path(3))
    canvas.drawn.clear()
    scene.again()
    assert {name for name, _, _ in canvas.drawn} >= {"grid", "path", "words"}


def test_every_topic_that_the_scene_subscribes_has_a_hand_for_it():
    assert all(hasattr(Scene, f"_on_{topic}") for topic in viewer_scene.SUBSCRIBES)
