"""Guests over a network: what each may see and do, proven with the guest in another network namespace."""

import json
import subprocess

import pytest

from runtime.access import keys
from tests.integration.remote.stage import KNOWN_CELLS, ROBOT


def test_a_viewer_sees_everything_of_its_robot_and_drives_nothing(robot):
    robot.invite("anna", "viewer")
    with robot:
        seen = robot.guest("anna")
        assert seen["scans"] > 50
        assert seen["map_bytes"] == 1_000_000
        assert seen["known_cells"] == KNOWN_CELLS
        assert seen["nodes"] == ["base"]
        assert seen["secrets"] == 0
        assert abs(seen["offset_ms"]) < 50  # one machine, two clocks of it
        assert robot.commands() == 0


def test_an_operator_sees_and_drives(robot):
    robot.invite("olga", "operator")
    with robot:
        seen = robot.guest("olga")
        assert seen["scans"] > 50
        assert robot.commands() >= 15


@pytest.mark.parametrize("mode", ["peer 1", "peer fedcba9876543210fedcba9876543210", "router 1"])
def test_a_guest_that_calls_itself_a_peer_or_a_router_gets_past_no_rule(robot, mode):
    # Of two peers the one with the greater name dials; the robot's would dial a guest that listens.
    robot.invite("anna", "viewer")
    with robot:
        seen = robot.guest("anna", mode=mode)
        assert seen["refused"] == ""
        assert (seen["secrets"], robot.commands()) == (0, 0)
        assert (seen["scans"] > 50) is mode.startswith("router")  # which passes on what its guest may see


def test_whoever_has_no_invitation_or_one_of_another_robot_is_refused(robot, tmp_path, monkeypatch):
    robot.invite("anna", "viewer")
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "stranger-owner"))
    keys.make("robot", [ROBOT])
    forged = keys.invite("robot", "anna", "operator", ROBOT)
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "stranger"))
    keys.write_private(tmp_path / "forged.invitation", forged.to_bytes())
    keys.pair(tmp_path / "forged.invitation")
    with robot:
        assert "cannot be reached" in robot.guest("stranger")["refused"]
        for endpoint in (f"tcp/{ROBOT}:7448", f"tls/{ROBOT}:7448", f"tcp/{ROBOT}:7447"):
            assert "cannot be reached" in robot.guest("anna", endpoint=endpoint)["refused"]
        assert robot.commands() == 0


def test_who_was_struck_off_the_list_sees_and_moves_nothing(robot, tmp_path, monkeypatch):
    robot.invite("olga", "operator")
    robot.invite("anna", "viewer")
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "owner"))
    keys.revoke("robot", "olga")
    with robot:
        seen = robot.guest("olga")
        assert (seen["scans"], seen["map_bytes"], seen["nodes"], seen["offset_ms"]) == (0, 0, [], None)
        assert seen["known_cells"] == 0
        assert robot.guest("anna")["scans"] > 50
        assert robot.commands() == 0


def state(guest):
    return json.loads(guest.stdout.readline())


def until(guest, condition, turns=600):
    """Read what a guest says, twenty times a second, until it says what is waited for."""
    for _ in range(turns):
        if condition(said := state(guest)):
            return said
    raise AssertionError(f"never came: {said}")


def without_news(guest):
    """Wait until a guest has seen no scan for two seconds; return what it said at their beginning."""
    last, since = state(guest), 0
    for _ in range(600):
        said = state(guest)
        since = since + 1 if said["scans"] == last["scans"] else 0
        if not since:
            last = said
        if since == 40:
            return last
    raise AssertionError("it still sees scans after half a minute")


def test_who_is_struck_off_while_inside_is_out_and_the_others_come_back_by_themselves(
    robot, tmp_path, monkeypatch
):
    robot.invite("olga", "operator")
    robot.invite("anna", "viewer")
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "owner"))
    with robot, robot.staying("olga") as olga, robot.staying("anna") as anna:
        for guest in (olga, anna):
            until(guest, lambda said: said["scans"] > 20)
        keys.revoke("robot", "olga")
        blind = without_news(olga)
        until(olga, lambda said: said["sent"] >= blind["sent"] + 60)
        assert state(olga)["scans"] == blind["scans"]
        seen = state(anna)["scans"]
        until(anna, lambda said: said["scans"] > seen + 50)
        for guest in (olga, anna):
            guest.communicate("end\n", timeout=30)
        assert robot.commands() <= blind["sent"] + 5  # of more than sixty that she sent after that


def test_the_robot_listens_at_its_one_door_only(robot):
    robot.invite("anna", "viewer")
    with robot:
        done = subprocess.run(
            ["ip", "netns", "exec", robot.here, "cat", "/proc/net/tcp", "/proc/net/tcp6", "/proc/net/udp"],
            capture_output=True,
            text=True,
            check=True,
        )
        rows = [line.split() for line in done.stdout.splitlines() if not line.strip().startswith("sl")]
        listening = [row[1] for row in rows if row[3] == "0A"]
        assert [address.split(":")[1] for address in listening] == [f"{7448:04X}"]
        assert "cannot be reached" not in robot.guest("anna")["refused"]
