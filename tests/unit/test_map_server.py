"""Maps as nav2's map_server and AMCL load them."""

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from runtime.formats.errors import FormatError
from runtime.formats.map_server import GridMap, read_map, trinary, write_map


def grid(rows, resolution_m=0.05, origin_m=(-1.0, 2.0)):
    return GridMap(np.array(rows, dtype=np.float32), resolution_m, origin_m)


def test_the_picture_is_trinary_and_its_first_row_is_the_highest_y():
    picture = trinary(grid([[0.0, 0.24, 0.25], [0.65, 0.66, np.nan]]).probability)
    assert picture.tolist() == [[205, 0, 205], [254, 254, 205]]


def test_the_yaml_holds_the_keys_that_map_server_documents(tmp_path):
    write_map(tmp_path, grid([[0.0, 1.0]]))
    assert yaml.safe_load((tmp_path / "map.yaml").read_text()) == {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": 0.05,
        "origin": [-1.0, 2.0, 0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    assert (tmp_path / "map.pgm").read_bytes() == b"P5\n2 1\n255\n\xfe\x00"


def test_map_server_reads_the_three_greys_as_they_are_meant(tmp_path):
    """Its rule: p = (255 - grey) / 255, occupied over one threshold, free under the other."""
    write_map(tmp_path, grid([[0.9, 0.1, np.nan]]))
    keys = yaml.safe_load((tmp_path / "map.yaml").read_text())
    greys = (tmp_path / "map.pgm").read_bytes()[-3:]
    states = []
    for grey in greys:
        p = (255 - grey) / 255
        free = p < keys["free_thresh"]
        states.append("occupied" if p > keys["occupied_thresh"] else "free" if free else "unknown")
    assert states == ["occupied", "free", "unknown"]


@given(
    hnp.arrays(
        np.float32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=30), elements=st.sampled_from([0, 1, 9])
    ),
    st.floats(0.01, 1.0).map(lambda r: float(f"{r:.3g}")),
)
def test_what_is_written_is_read_again(tmp_path_factory, cells, resolution_m):
    folder = tmp_path_factory.mktemp("map")
    cells[cells == 9] = np.nan
    write_map(folder, GridMap(cells, resolution_m, (-3.25, 4.5)))
    got = read_map(folder / "map.yaml")
    np.testing.assert_array_equal(got.probability, cells)
    assert (got.resolution_m, got.origin_m) == (resolution_m, (-3.25, 4.5))


def test_a_picture_with_comments_in_its_header_is_read(tmp_path):
    write_map(tmp_path, grid([[0.0, 1.0]]))
    (tmp_path / "map.pgm").write_bytes(b"P5\n# by hand\n2 1\n# again\n255\n\x00\xfe")
    assert read_map(tmp_path / "map.yaml").probability.tolist() == [[1.0, 0.0]]


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("map.yaml", b"image: map.pgm\n", "map_server keys missing: resolution, origin, negate"),
        ("map.yaml", b"7\n", "map_server keys missing: image"),
        ("map.pgm", b"P5\n2 1\n255\n\x00", "1 bytes of picture, must be 2"),
        ("map.pgm", b"P6\n2 1\n255\n\x00\x00", "header b'P6 2 1 255', must be P5"),
        ("map.pgm", b"P5\n2", "its header ends too early"),
        ("map.pgm", b"", "its header ends too early"),
    ],
)
def test_a_bad_map_is_one_line_of_place_rule_and_value(tmp_path, name, text, said):
    write_map(tmp_path, grid([[0.0, 1.0]]))
    (tmp_path / name).write_bytes(text)
    with pytest.raises(FormatError, match=said):
        read_map(tmp_path / "map.yaml")


def test_a_turned_origin_is_refused(tmp_path):
    write_map(tmp_path, grid([[0.0, 1.0]]))
    text = (tmp_path / "map.yaml").read_text().replace(", 0]", ", 0.5]")
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(FormatError, match=r"origin = \[-1.0, 2.0, 0.5\], must be \[x, y, 0\]"):
        read_map(tmp_path / "map.yaml")
