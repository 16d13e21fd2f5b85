"""What a run is: left in its directory, told to guests, unknown where nobody tells it."""

import pytest

from runtime.bus.memory import MemoryBus
from runtime.process.identity import Identity, left_in, tell, told

RUN = Identity(seed=7, domain=3, clock_offset_ns=5, version="1.2", host="onboard", config="nodes: {}\n")


def test_a_guest_is_told_what_the_run_has_left_in_its_directory(tmp_path):
    Identity(seed=7, domain=3, clock_offset_ns=5, version="1.2", host="onboard").leave(tmp_path)
    (tmp_path / "config.yaml").write_text("nodes: {}\n")
    with MemoryBus() as robot, robot.join() as guest:
        tell(robot, "robot", left_in(tmp_path))
        assert told(guest.ask, "robot") == left_in(tmp_path) == RUN
        assert told(guest.ask, "other") == Identity()


def test_nothing_is_made_up_where_nothing_was_left(tmp_path):
    assert left_in(tmp_path) == Identity(seed=None, clock_offset_ns=None)


@pytest.mark.parametrize("data", [b"", b"\xff", b"[]", b'{"seed": "7", "domain": 1.5, "later": 1}'])
def test_what_is_not_understood_is_unknown(data):
    assert Identity.decode(data) == Identity()


def test_what_a_later_version_adds_is_passed_over():
    assert Identity.decode(b'{"seed": 7, "later": 1, "clock_offset_ns": null}') == Identity(seed=7)
