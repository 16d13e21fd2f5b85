"""A session in the viewer: its map as it lies, each scan where it was made, each drive a way of its own."""

import io

import numpy as np
import pytest
from PIL import Image

from runtime.formats.session import CutSessionError, Parts, SessionWriter
from runtime.formats.tum import tum_lines
from runtime.messages import LaserScan, encode, header
from runtime.nodes.viewing.recording import draw, shown
from runtime.nodes.viewing.session import cells_of

# Rows from the top, as a picture has them: wall and unknown, then free and free.
PICTURE = np.array(((0, 205), (254, 254)), dtype=np.uint8)
STEP_NS = 250_000_400


class Canvas:
    """Keeps what was drawn."""

    def __init__(self):
        self.drawn = []

    def __getattr__(self, name):
        return lambda *arguments: self.drawn.append((name, arguments))

    def of(self, kind):
        return [arguments for name, arguments in self.drawn if name == kind]


def scan(stamp_ns):
    return encode(
        LaserScan(
            header=header(stamp_ns, "laser"), angle_min=-1.0, angle_max=1.0, angle_increment=0.02,
            time_increment=0.0, scan_time=0.1, range_min=0.02, range_max=30.0,
            ranges=np.full(101, 2.0, dtype=np.float32), intensities=np.zeros(0, np.float32),
        )
    )  # fmt: skip


@pytest.fixture
def session(tmp_path):
    """Write two drives of eight scans, half a metre a scan, and two metres apart."""
    path = tmp_path / "kitchen.mcap"
    file = io.BytesIO()
    Image.fromarray(PICTURE).save(file, "PNG")
    stamps = np.arange(1, 17) * STEP_NS
    poses = np.zeros((16, 3))
    poses[:, 0] = 0.5 * np.arange(16) + 2.0 * (np.arange(16) >= 8)
    writer = SessionWriter(path, {"version": "1", "seed": "0"})
    for number, stamp_ns in enumerate(stamps.tolist()):
        writer.add(1 + number // 8, stamp_ns, scan(stamp_ns))
    # The last scan has no pose: it cannot be shown, and must hinder nothing.
    trajectory = "".join(tum_lines(stamps[:15], poses[:15])).encode()
    empty = {"paints": np.zeros(0, np.uint8)}
    writer.finish(
        Parts(
            posterior={}, config="{}\n", trajectory=trajectory, picture=file.getvalue(), resolution_m=0.05,
            origin_m=(-1.0, 3.0), layer=empty,
        )
    )  # fmt: skip
    return path


def test_the_picture_of_a_map_lies_in_cells_as_ros_has_them():
    file = io.BytesIO()
    Image.fromarray(PICTURE).save(file, "PNG")
    assert cells_of(file.getvalue()).tolist() == [[0, 0], [100, -1]]


def test_a_session_shows_its_map_its_scans_and_the_way_of_the_last_drive(session):
    canvas = Canvas()
    content = shown(session)
    assert content.name == "kitchen"
    assert draw(content, canvas) == 1 + 2 + 15 * 3  # the map, two beginnings, three messages a scan
    cells, resolution_m, origin_m = canvas.of("grid")[-1]
    assert (cells.tolist(), resolution_m, origin_m) == ([[0, 0], [100, -1]], 0.05, (-1.0, 3.0))
    words = [one[0] for one in canvas.of("words")]
    assert words[0] == words[-1]
    assert words[0].startswith("# SAVED\n\nA session of 2 drives")
    np.testing.assert_allclose(canvas.of("path")[-1][0][:, 0], 6.0 + 0.5 * np.arange(7), atol=1e-6)
    lasers = np.array([arguments[0] for arguments in canvas.of("laser")])
    # The newest waits for a scan after it, which never comes.
    np.testing.assert_allclose(lasers[:, 0], [*0.5 * np.arange(8), *(6.0 + 0.5 * np.arange(6))], atol=1e-6)
    rays = canvas.of("scan")[-1][0]
    np.testing.assert_allclose(np.hypot(*(rays - lasers[-1, :2]).T), 2.0, atol=0.02)


def test_a_cut_session_is_refused_with_the_way_to_map_it_again(session):
    data = session.read_bytes()
    session.write_bytes(data[: len(data) - 40])
    with pytest.raises(CutSessionError, match="hallway map"):
        shown(session)
