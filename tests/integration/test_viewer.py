"""The viewer as a whole: its process, its program, and the picture that a person sees."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from runtime.bus.memory import MemoryBus
from runtime.nodes import viewer
from runtime.nodes.viewing import scene as viewer_scene
from runtime.nodes.viewing import server as viewer_server
from runtime.nodes.viewing.painter import WAITING_MAX, Painter
from runtime.process.node import BusPort
from tests.integration import browser
from tests.integration import viewer_story as story

RED, BLUE, WHITE, WALL = (214, 40, 40), (38, 99, 214), (255, 255, 255), (28, 28, 28)
WARN = (255, 122, 12)  # the program's own


def need(there, what):
    """Skip by name where something is missing, except where it must not be."""
    if not there and os.environ.get("CI_REQUIRE_BROWSER"):
        pytest.fail(f"needs {what}, and CI_REQUIRE_BROWSER is set")
    if not there:
        pytest.skip(f"needs {what}")


def count(image, colour, tolerance=30):
    """How many pixels have a colour."""
    return int((np.abs(np.asarray(image).astype(int) - colour).max(axis=-1) <= tolerance).sum())


def until(condition, within_s=20.0):
    """Wait for something, not for ever."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.01)
    return False


@pytest.fixture
def bus():
    with MemoryBus() as first:
        yield first


class Process:
    """A viewer node in a thread, on the bus in memory, and a robot that speaks to it."""

    def __init__(self, bus, run_dir, **config):
        topics = viewer_scene.SUBSCRIBES
        self.robot = BusPort("robot", bus.join, publishes=topics)
        self.port = BusPort("viewer", bus.join, subscribes=topics, run_dir=run_dir)
        self.code, self.where = None, ""
        self._config = viewer.Config(**config)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        self.code = viewer.run(self.port, self._config, say=lambda where: setattr(self, "where", where))

    @property
    def words(self):
        return self.port._state

    def ready(self):
        return until(lambda: self.port._is_ready)

    def tell(self, scans=40):
        for one in story.drive(scans):
            self.robot.publish(one.topic, one.message)
            if one.topic == "odom":
                time.sleep(0.005)  # the inbox keeps the newest scan alone: let it be taken

    def ended(self, within_s=5.0):
        self._thread.join(within_s)
        return not self._thread.is_alive()

    def stop(self):
        self.port.stop()
        return self.ended()

    def close(self):
        self.stop()
        self.port.close()
        self.robot.close()


@pytest.fixture
def start(bus, tmp_path):
    processes = []

    def made(**config):
        processes.append(Process(bus, tmp_path, **config))
        assert processes[-1].ready()
        return processes[-1]

    yield made
    for process in processes:
        process.close()


# ---- the thread that draws ----


def test_a_canvas_that_hangs_delays_nobody_and_costs_only_old_drawings():
    hanging, drawn = threading.Event(), []

    painter = Painter(None)
    painter.paint("first", lambda _: hanging.wait(30))
    assert until(lambda: painter.stuck_s > 0)
    began = time.monotonic()
    for number in range(1000):
        painter.paint("scan", lambda _, n=number: drawn.append(n))
    assert time.monotonic() - began < 1.0
    assert not painter.close(0.05)
    assert painter.dropped == 999
    hanging.set()
    assert painter.close(5.0)
    assert drawn == [999]


def test_drawings_of_ever_new_kinds_wait_in_bounded_memory():
    hanging = threading.Event()
    painter = Painter(None)
    painter.paint("first", lambda _: hanging.wait(30))
    assert until(lambda: painter.stuck_s > 0)
    for number in range(3 * WAITING_MAX):
        painter.paint(f"note {number}", lambda _: None)
    assert painter.dropped == 2 * WAITING_MAX
    hanging.set()
    assert painter.close(5.0)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_canvas_that_fails_is_noticed():
    painter = Painter(None)
    painter.paint("scan", lambda _: 1 / 0)
    assert until(lambda: painter.failed)


# ---- the program that shows the picture ----


def ports():
    """Two ports that nobody has."""
    first = viewer_server.free_port(0)
    return {"port": first, "web_port": viewer_server.free_port(0, taken=first)}


@pytest.fixture
def server():
    with_page = viewer_server.ViewerServer(web=True, **ports(), memory_mb=64)
    yield with_page
    with_page.close()


def listening(pid):
    """Addresses (hex, as the kernel prints them) on which a process listens."""
    inodes = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        target = os.readlink(entry)
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    rows = [
        line.split()
        for table in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{table}").read_text().splitlines()
    ]
    return {row[1].split(":")[0] for row in rows if len(row) > 9 and row[9] in inodes and row[3] == "0A"}


def test_it_listens_on_this_machine_alone(server):
    assert listening(server._process.pid) == {"0100007F"}  # 127.0.0.1


def test_a_taken_port_is_left_to_its_owner(server):
    page_port = int(server.page.split("/")[2].rpartition(":")[2])
    second = viewer_server.ViewerServer(web=True, port=server.port, web_port=page_port, memory_mb=64)
    try:
        assert second.port != server.port
        assert second.page != server.page
        assert second.listens()
    finally:
        second.close()
    assert server.listens()


def test_it_ends_when_it_is_told_even_if_it_is_stopped(server):
    os.kill(server._process.pid, signal.SIGSTOP)
    began = time.monotonic()
    server.close()
    assert server.exit_code is not None
    assert time.monotonic() - began < 3.0


def test_it_does_not_outlive_whoever_started_it(tmp_path):
    script = (
        "import os, sys, time\n"
        "from runtime.nodes.viewing.server import ViewerServer, free_port\n"
        "server = ViewerServer(web=True, port=free_port(0), web_port=free_port(0), memory_mb=64)\n"
        "print(server._process.pid, server.port, flush=True)\n"
        "time.sleep(60)\n"
    )
    owner = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, cwd=Path.cwd()
    )
    with owner:
        pid, port = map(int, owner.stdout.readline().split())
        owner.kill()
    assert until(lambda: not viewer_server.listens(port))
    assert until(
        lambda: not Path(f"/proc/{pid}").exists() or "Z" in Path(f"/proc/{pid}/stat").read_text().split()[2]
    )


# ---- the node ----


def test_a_run_is_saved_as_a_file_that_rerun_reads(start, tmp_path):
    file = tmp_path / "run.rrd"
    process = start(mode="save", file=str(file))
    process.tell()
    assert process.stop()
    assert process.code == 0
    stats = subprocess.run(
        [viewer_server.program(), "rrd", "stats", str(file)], capture_output=True, text=True, check=True
    ).stdout
    for path in ("/world/map", "/world/scan/used", "/world/trajectory", "/world/particles", "/state/words"):
        assert path in stats


@pytest.mark.parametrize("told", [True, False])
def test_a_saved_session_has_no_empty_places_for_what_a_robot_tells(tmp_path, told):
    from runtime.nodes.viewing.screen import Screen

    Screen("robot", file=tmp_path / "run.rrd", told=told).close(10.0)
    command = [viewer_server.program(), "rrd", "print", "-vvv", str(tmp_path / "run.rrd")]
    views = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "TextDocument" in views
    assert ("TimeSeries" in views) is ("TextLog" in views) is told


def test_what_happened_is_told_with_its_time_of_day(tmp_path):
    from runtime.nodes.viewing.screen import Screen

    screen = Screen("robot", file=tmp_path / "run.rrd")
    screen.at(story.stamp(25))
    screen.note("warn", "laser: rate is 8 Hz")
    screen.close(10.0)
    command = [viewer_server.program(), "rrd", "print", "-vvv", "--entity", "log", str(tmp_path / "run.rrd")]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "14:13:22 laser: rate is 8 Hz" in told


def test_a_viewer_whose_program_is_killed_says_so_and_ends(start):
    process = start(mode="web", **ports(), memory_mb=64)
    process.tell(5)
    os.kill(_child_of_us(), signal.SIGKILL)
    assert process.ended(10.0)
    assert process.code == 1
    assert process.words[0] == "error"
    assert "ended with code -9" in process.words[1]


def test_a_viewer_whose_program_stands_still_stops_within_two_seconds(start):
    process = start(mode="web", **ports(), memory_mb=64)
    process.tell(5)
    os.kill(_child_of_us(), signal.SIGSTOP)
    process.tell(100)
    began = time.monotonic()
    assert process.stop()
    assert time.monotonic() - began < 2.5
    assert process.code == 0


def test_a_viewer_that_ends_leaves_its_program_without_a_complaint(start, capfd):
    process = start(mode="web", **ports(), memory_mb=64)
    process.tell(20)
    program = _child_of_us()
    assert os.getpgid(program) != os.getpgid(0)  # Ctrl-C in the terminal is not for it
    assert process.stop()
    assert process.code == 0
    assert capfd.readouterr().err == ""


def test_a_full_file_ends_the_saving_and_not_the_disk(start, tmp_path, monkeypatch):
    file = tmp_path / "run.rrd"
    process = start(mode="save", file=str(file), file_mb=16)
    monkeypatch.setattr(viewer.Config, "__post_init__", lambda self: None)
    process._config = viewer.Config(mode="save", file=str(file), file_mb=16)
    with file.open("ab") as more:
        more.truncate(17_000_000)
    assert process.ended(10.0)
    assert process.code == 0
    assert "is full: 16 MB" in process.words[1]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"port": 0}, "port = 0"),
        ({"memory_mb": 1}, "memory_mb = 1"),
        ({"mode": "save"}, "file = ''"),
        ({"mode": "web", "file": "x.rrd"}, "file = 'x.rrd'"),
    ],
)
def test_a_wrong_value_is_named(wrong, message):
    with pytest.raises(ValueError, match=message):
        viewer.Config(**wrong)


def _child_of_us():
    """The one viewer program that this process started and that still runs."""
    children = [
        int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit() and _is_our_viewer(path)
    ]
    assert len(children) == 1
    return children[0]


def _is_our_viewer(path):
    try:
        fields = (path / "stat").read_text().rsplit(")", 1)[1].split()
        return int(fields[1]) == os.getpid() and fields[0] != "Z" and "rerun" in (path / "comm").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False


# ---- what a person sees ----


def shows_the_room(image):
    """Free ground, walls, the red way and the blue points, each in plenty."""
    return (
        count(image, WHITE, 2) > 10_000
        and count(image, WALL) > 300
        and count(image, RED) > 200
        and count(image, BLUE) > 10
    )


def photograph(file, size):
    """What a saved picture looks like in a window of a size."""
    shot = file.with_name("shot.png")
    command = [
        viewer_server.program(),
        "-",
        "--headless",
        "--window-size",
        size,
        "--screenshot-to",
        str(shot),
    ]
    with file.open("rb") as recording:
        subprocess.run(command, stdin=recording, capture_output=True, timeout=60, check=True)
    return Image.open(shot).convert("RGB")


def test_the_side_has_room_for_six_lines_of_what_happened(start, tmp_path):
    need(list(Path("/usr/share/vulkan/icd.d").glob("lvp*")), "mesa-vulkan-drivers")
    process = start(mode="save", file=str(tmp_path / "run.rrd"))
    late = [story.diagnostics(0, f"node_{number}", 1, "is late") for number in range(6)]
    late[0].status = [one.status[0] for one in late]
    process.robot.publish("diagnostics", late[0])
    assert until(lambda: process.words[2].get("drawings", 0) >= 6)
    assert process.stop()
    image = photograph(tmp_path / "run.rrd", "1500x900")
    side = np.asarray(image)[image.height // 2 :, : image.width // 4].astype(int)
    lines = (np.abs(side - WARN).max(axis=-1) <= 10).any(axis=1)
    assert np.count_nonzero(lines[1:] & ~lines[:-1]) >= 6, "see shot.png"


def test_the_picture_shows_walls_free_ground_way_and_points(start, tmp_path):
    need(list(Path("/usr/share/vulkan/icd.d").glob("lvp*")), "mesa-vulkan-drivers")
    process = start(mode="save", file=str(tmp_path / "run.rrd"))
    process.tell()
    assert process.stop()
    image = photograph(tmp_path / "run.rrd", "1100x700")
    assert shows_the_room(image), "see shot.png"
    # The room is twice as wide as it is high: nothing is turned or stretched.
    free = np.argwhere((np.asarray(image)[:, image.width // 3 :] > 252).all(axis=-1))
    height, width = np.percentile(free, 99, axis=0) - np.percentile(free, 1, axis=0)
    assert width / height == pytest.approx(2.1, abs=0.25)


def test_the_page_shows_the_same_in_a_browser(start, tmp_path):
    need(browser.PROGRAM, "chromium")
    process = start(mode="web", **ports(), memory_mb=128)
    process.tell()
    assert re.match(r"http://127\.0\.0\.1:\d+/\?url=", process.where)
    with browser.Browser(process.where, tmp_path / "profile") as page:
        seen = until(lambda: shows_the_room(page.screenshot()), within_s=90.0)
        page.screenshot().save(tmp_path / "page.png")
    assert seen, "see page.png"
