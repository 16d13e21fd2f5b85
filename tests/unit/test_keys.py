"""Keys, guests and their list: what is secret stays readable for its owner alone."""

import json
import os
import stat

import pytest

from runtime.access import gate, keys
from runtime.bus import links
from runtime.cli import main
from runtime.errors import ConfigError
from runtime.supervision import hub


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "keys"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_is_secret_is_readable_for_its_owner_alone(home):
    made = keys.make("robot")
    invitation = keys.invite("robot", "anna", "viewer", "10.0.0.1")
    keys.write_private(home / "anna.invitation", invitation.to_bytes())
    keys.pair(home / "anna.invitation")
    secret = [
        made.key,
        made.folder / "ca.key",
        home / "keys" / "paired" / "robot.json",
        home / "anna.invitation",
    ]
    assert [stat.S_IMODE(path.stat().st_mode) for path in secret] == [0o600] * 4
    assert stat.S_IMODE(made.folder.stat().st_mode) == 0o700


def test_an_invitation_comes_back_as_it_was(home):
    keys.make("robot")
    invitation = keys.invite("robot", "anna", "operator", "10.0.0.1:9999")
    file = home / "a.invitation"
    keys.write_private(file, invitation.to_bytes())
    assert keys.pair(file) == invitation == keys.paired("robot")
    assert keys.paired("another") is None
    assert (invitation.address, invitation.role) == ("10.0.0.1:9999", "operator")


def test_keys_are_made_once(home):
    keys.make("robot")
    with pytest.raises(ConfigError, match="holds keys already"):
        keys.make("robot")


def test_without_keys_nobody_is_invited(home):
    with pytest.raises(ConfigError, match="robot 'robot' has no keys yet; make them with: hallway keys make"):
        keys.invite("robot", "anna", "viewer", "10.0.0.1")


def test_a_guest_is_on_the_list_once_and_can_be_struck_off(home):
    host = keys.make("robot")
    keys.invite("robot", "anna", "viewer", "h")
    with pytest.raises(ConfigError, match="guest 'anna' is on the list already, as viewer"):
        keys.invite("robot", "anna", "operator", "h")
    keys.revoke("robot", "anna")
    assert host.roster() == {}
    with pytest.raises(ConfigError, match="guest 'anna': not on the list; on it: nobody"):
        keys.revoke("robot", "anna")


@pytest.mark.parametrize("guest", ["", "Anna", "a b", "../x", "-x", "x" * 60])
def test_a_guest_has_a_plain_name(home, guest):
    keys.make("robot")
    with pytest.raises(ConfigError, match="must be lower-case"):
        keys.invite("robot", guest, "viewer", "h")


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"hallway": "invitation"}', '{"hallway": "invitation", "x": 1}']
)
def test_another_file_is_no_invitation(home, text):
    (home / "x").write_text(text)
    with pytest.raises(ConfigError, match="x: is no invitation of a robot"):
        keys.Invitation.read(home / "x")


def test_the_door_denies_what_no_rule_allows_and_names_each_guest(home):
    host = keys.make("robot")
    keys.invite("robot", "anna", "viewer", "h")
    keys.invite("robot", "olga", "operator", "h")
    keys.invite("robot", "desk", "machine", "h")
    door = gate.door(host, "robot", 7, "0.0.0.0:7448", host.roster())
    access = door["access_control"]
    assert access["default_permission"] == "deny"
    roles = {subject["id"]: subject.get("cert_common_names") for subject in access["subjects"]}
    assert roles == {
        "local": None,
        "viewer": ["guest anna"],
        "operator": ["guest olga"],
        "machine": ["guest desk"],
    }
    writes = {rule["id"]: rule["key_exprs"] for rule in access["rules"] if "put" in rule["messages"]}
    assert writes["drive_in"] == ["7/robot/cmd_vel/**"]
    allowed = {policy["subjects"][0]: policy["rules"] for policy in access["policies"]}
    assert allowed["viewer"] == ["read_in", "read_out"]
    assert [role for role, rules in allowed.items() if "work_in" in rules] == ["machine"]
    assert {"7/robot/odom/**", "7/robot/map/**/@adv/**", "hallway/robot/map"} <= set(writes["work_in"])
    # What devices say, and who the robot is, is nobody's elsewhere.
    said = {key.split("/")[2] for key in writes["work_in"] if key.startswith("7/robot/")}
    assert not said & {"scan", "battery", "bumper", "truth", "clock"}
    assert "hallway/robot/clock" not in writes["work_in"]
    assert host.key.read_text() not in str(door)


def test_the_command_makes_invites_lists_revokes_and_pairs(home, capsys):
    assert main(["keys", "make", "--host", "10.0.0.1"]) == 0
    assert main(["keys", "invite", "anna", "--role", "operator", "--address", "10.0.0.1"]) == 0
    assert main(["keys", "list"]) == 0
    assert main(["keys", "pair", "anna.invitation"]) == 0
    assert main(["keys", "revoke", "anna"]) == 0
    out = capsys.readouterr().out
    assert "anna                 operator" in out
    assert "robot 'robot' at 10.0.0.1:7448: paired, as operator" in out
    assert "PRIVATE KEY" not in out
    assert main(["keys", "revoke", "anna"]) == 2


@pytest.mark.parametrize("damage", ["{cut", "[1, 2]", "7"])
def test_a_damaged_list_of_guests_lets_nobody_in_and_does_not_end_a_hub_that_runs(home, damage):
    host = keys.make("robot")
    keys.invite("robot", "anna", "viewer", "10.0.0.1")
    listed = host.roster()
    (host.folder / "roster.json").write_text(damage)
    with pytest.raises(ConfigError, match="is no list of guests"):
        host.roster()
    assert hub._has_changed(host, listed) is False
    host.write_roster({})
    assert hub._has_changed(host, listed) is True


def test_the_processes_of_a_robot_dial_nobody_over_a_network_and_its_hub_lets_in_by_tls_alone(home):
    host = keys.make("robot")

    def protocols(session):
        return session["transport"]["link"]["protocols"]

    assert protocols(links.peer(home, "base")) == ["unixsock-stream"]
    assert protocols(links.visitor(home)) == ["unixsock-stream"]
    assert protocols(links.hub(home)) == ["unixsock-stream"]
    door = gate.door(host, "robot", 0, "0.0.0.0:7448", {})
    assert protocols(links.hub(home, door)) == ["unixsock-stream", "tls"]
    assert protocols(gate.guest(keys.invite("robot", "anna", "viewer", "10.0.0.1"))) == ["tls"]


def test_the_hub_of_another_machine_listens_for_its_own_and_leads_to_the_robot_that_may_come_later(home):
    keys.make("robot")
    session = links.hub(home, gate.lead(keys.invite("robot", "desk", "machine", "10.0.0.1")))
    assert session["listen"]["endpoints"] == [links.socket(home, "hub")]
    assert session["connect"]["endpoints"] == ["tls/10.0.0.1:7448"]
    assert (session["connect"]["exit_on_failure"], session["connect"]["timeout_ms"]) == (False, -1)
    assert session["transport"]["link"]["tls"]["enable_mtls"] is True


def test_a_machine_with_ros_gets_a_router_that_leads_to_the_robot_and_listens_for_itself_alone(home, capsys):
    keys.make("robot")
    keys.write_private(
        home / "rviz.invitation", keys.invite("robot", "rviz", "viewer", "10.0.0.1").to_bytes()
    )
    assert main(["keys", "ros", "rviz.invitation"]) == 0
    said = capsys.readouterr().out
    assert "rviz.json5: leads to robot 'robot' as viewer; it is secret" in said
    assert f"ZENOH_ROUTER_CONFIG_URI={home / 'rviz.json5'} ros2 run rmw_zenoh_cpp rmw_zenohd" in said
    assert stat.S_IMODE((home / "rviz.json5").stat().st_mode) == 0o600
    config = json.loads((home / "rviz.json5").read_text())
    assert config["mode"] == "router"
    assert config["listen"]["endpoints"] == ["tcp/localhost:7447"]  # where the sessions of rmw_zenoh look
    assert config["connect"]["endpoints"] == ["tls/10.0.0.1:7448"]
    assert config["scouting"]["multicast"]["enabled"] is False
    assert config["transport"]["link"]["tls"]["enable_mtls"] is True


def test_no_file_is_written_over_for_ros(home, capsys):
    keys.make("robot")
    keys.write_private(home / "a.invitation", keys.invite("robot", "a", "viewer", "h").to_bytes())
    (home / "a.json5").write_text("mine")
    assert main(["keys", "ros", "a.invitation"]) == 2
    assert "a.json5: exists already" in capsys.readouterr().err
    assert (home / "a.json5").read_text() == "mine"
    assert main(["keys", "ros", "a.json5"]) == 2
    assert "a.json5: is no invitation of a robot" in capsys.readouterr().err


def test_no_keys_are_made_for_a_robot_that_cannot_be(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert main(["keys", "make", "--robot", "1st"]) == 2
    assert capsys.readouterr().err == (
        "hallway keys: --robot = '1st', must be lower-case letters, digits and underscores\n"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "host",
    [
        "bad host",
        "",
        "x..y",
        "-x",
        "x-",
        ".",
        "m\u00fcller",
        "10.0.0.999",
        "10.0.0.1:7448",
        "a" * 64,
        "a." * 127 + "a",
    ],
)
def test_no_keys_are_made_for_a_host_that_cannot_be(home, capsys, host):
    assert main(["keys", "make", f"--host={host}"]) == 2
    said = capsys.readouterr().err
    assert said == f"hallway keys: host = {host!r}, must be a DNS name or an IP address, without a port\n"
    assert list(home.iterdir()) == []


@pytest.mark.parametrize(
    "host", ["10.0.0.1", "fe80::1", "robot", "Robot-7.local", "my_robot", "7up.example.org"]
)
def test_a_host_is_an_address_or_a_name(home, host):
    assert main(["keys", "make", "--host", host]) == 0


def test_a_machine_whose_own_name_is_none_of_dns_has_keys_without_it(home, monkeypatch):
    monkeypatch.setattr("runtime.access.keys.socket.gethostname", lambda: "m\u00fcller")
    assert keys.make("robot").certificate.exists()


@pytest.mark.parametrize("address", ["bad host", "bad host:7448", "[::1", "h::1x:7"])
def test_nobody_is_invited_to_an_address_that_cannot_be(home, address):
    host = keys.make("robot")
    with pytest.raises(ConfigError, match="must be HOST or HOST:PORT"):
        keys.invite("robot", "anna", "viewer", address)
    assert host.roster() == {}


@pytest.mark.parametrize("words", [["invite", "bob"], ["ros", "anna.invitation"]])
@pytest.mark.parametrize("out", ["/proc/x", "/proc/a/x"])
def test_where_nothing_can_be_written_is_told_by_the_name_that_was_given(home, capsys, words, out):
    host = keys.make("robot")
    keys.write_private(home / "anna.invitation", keys.invite("robot", "anna", "viewer", "h").to_bytes())
    assert main(["keys", *words, "--out", out]) == 2
    assert capsys.readouterr().err == f"hallway keys: {out}: /proc cannot be written to\n"
    assert host.roster() == {"anna": "viewer"}


def test_a_disk_that_fails_leaves_nobody_on_the_list_and_no_half_of_a_key(home, capsys, monkeypatch):
    host = keys.make("robot")

    def full(descriptor):
        if (home / f".bob.invitation.{os.getpid()}").exists():
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("runtime.access.keys.os.fsync", full)
    assert main(["keys", "invite", "bob", "--address", "h", "--out", str(home / "bob.invitation")]) == 2
    said = capsys.readouterr().err
    assert said == f"hallway keys: {home / 'bob.invitation'}: cannot be written: No space left on device\n"
    assert host.roster() == {}
    assert [path.name for path in home.iterdir()] == ["keys"]


def test_nobody_is_on_the_list_whose_invitation_cannot_be_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    keys.make("robot", ["h"])
    out = tmp_path / "a file" / "anna.invitation"
    (tmp_path / "a file").touch()
    assert main(["keys", "invite", "anna", "--address", "h", "--out", str(out)]) == 2
    assert capsys.readouterr().err.endswith(f"{tmp_path / 'a file'} cannot be written to\n")
    assert keys.authority("robot").roster() == {}
