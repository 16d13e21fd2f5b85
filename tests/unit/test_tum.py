"""Trajectories on disk."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.formats.errors import FormatError
from runtime.formats.relations import read_relations
from runtime.formats.tum import read_tum, tum_lines, tum_stamp, write_tum


def test_a_line_is_stamp_position_and_quaternion(tmp_path):
    stamps = np.array([976052857337530000, 976052857337529000])
    poses = np.array([[1.5, -2.0, math.pi / 2], [-0.0, 0.0, 0.0]])
    write_tum(tmp_path / "t.tum", stamps, poses)
    assert (tmp_path / "t.tum").read_text().splitlines() == [
        "976052857.337530 1.500000 -2.000000 0.000000 0.000000000 0.000000000 0.707106781 0.707106781",
        "976052857.337529 0.000000 0.000000 0.000000 0.000000000 0.000000000 0.000000000 1.000000000",
    ]


@pytest.mark.parametrize(
    ("stamp_ns", "text"),
    [(0, "0.000000"), (1_500, "0.000002"), (1_499, "0.000001"), (999_999_999, "1.000000")],
)
def test_stamps_are_printed_in_microseconds_from_their_integer(stamp_ns, text):
    assert tum_stamp(stamp_ns) == text


@given(
    st.lists(
        st.tuples(
            st.integers(0, 2**60 // 1000),
            st.floats(-1e4, 1e4),
            st.floats(-1e4, 1e4),
            st.floats(-math.pi, math.pi, exclude_max=True),
        ),
        min_size=1,
        max_size=20,
    )
)
def test_what_is_written_is_read_again(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("tum") / "t.tum"
    stamps = np.array([row[0] * 1000 for row in rows])
    poses = np.array([row[1:] for row in rows])
    write_tum(path, stamps, poses)
    got = read_tum(path)
    assert got.stamps_ns.tolist() == stamps.tolist()
    np.testing.assert_allclose(got.poses[:, :2], poses[:, :2], atol=6e-7)
    turn = (got.poses[:, 2] - poses[:, 2] + math.pi) % (2 * math.pi) - math.pi
    assert np.abs(turn).max() < 1e-8


def test_the_last_column_is_never_negative():
    poses = np.column_stack((np.zeros(100), np.zeros(100), np.linspace(-9, 9, 100)))
    assert all(float(line.split()[7]) >= 0 for line in tum_lines(np.arange(100), poses))


def test_yaw_is_read_from_a_quaternion_that_also_pitches(tmp_path):
    (tmp_path / "t.tum").write_text("# stamp x y z q\n1.0 0 0 5 0 0.0998334 0 0.9950042\n")
    assert read_tum(tmp_path / "t.tum").poses[0].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# nothing\n", "0 poses found"),
        ("1 2 3\n", ":1: 3 columns, must be 8: stamp x y z qx qy qz qw"),
        ("1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 x\n", ":2: pose value 6 = 'x', must be a number"),
        ("1 0 0 0 0 0 0 0\n", ":1: pose 0 0 0 0 0 0 0, must be finite, with a quaternion"),
        ("1 nan 0 0 0 0 0 1\n", ":1: pose nan 0 0 0 0 0 1, must be finite"),
    ],
)
def test_a_bad_trajectory_is_one_line_of_place_rule_and_value(tmp_path, text, said):
    (tmp_path / "t.tum").write_text(text)
    with pytest.raises(FormatError, match=said):
        read_tum(tmp_path / "t.tum")


def test_a_trajectory_whose_last_line_is_cut_off_is_read_up_to_there(tmp_path):
    line = "1 0 0 0 0 0 0 1\n"
    (tmp_path / "t.tum").write_text(2 * line + line[:8])
    trajectory = read_tum(tmp_path / "t.tum")
    assert len(trajectory) == 2
    assert trajectory.losses == (f"{tmp_path / 't.tum'}:3: the last line is cut off, and left out",)
    for text in (line[:8], line + line[:8] + "\n" + line):
        (tmp_path / "t.tum").write_text(text)
        with pytest.raises(FormatError, match="columns, must be 8"):
            read_tum(tmp_path / "t.tum")


def test_relations_are_pairs_of_stamps_and_a_planar_pose(tmp_path):
    (tmp_path / "r").write_text("1216.630413 1217.490267 0.4 -0.1 9 9 9 -0.07\n")
    relations = read_relations(tmp_path / "r")
    assert relations.stamps_a_ns.tolist() == [1216630413000]
    assert relations.stamps_b_ns.tolist() == [1217490267000]
    assert relations.a_t_b.tolist() == [[0.4, -0.1, -0.07]]


@pytest.mark.parametrize(
    ("text", "said"), [("1 2 3\n", ":1: 3 columns"), ("\n", "0 relations"), ("1 2 inf 0 0 0 0 0\n", "finite")]
)
def test_bad_relations_are_one_line(tmp_path, text, said):
    (tmp_path / "r").write_text(text)
    with pytest.raises(FormatError, match=said):
        read_relations(tmp_path / "r")
