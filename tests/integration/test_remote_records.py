"""What a guest takes home over a network: recordings that tell of the run, and nobody's secrets."""

import base64
import time
from pathlib import Path

from runtime.access import keys
from runtime.formats.mcap_log import McapReader


def test_a_guest_records_what_the_run_is_and_how_far_its_clock_is(robot, tmp_path):
    robot.invite("anna", "viewer")
    with robot.started("ahead"):
        recorder = robot.typed("anna", "record", "--duration", "1", "--out", "a.mcap")
        _, told = recorder.communicate(timeout=60)
    assert recorder.returncode == 0, told
    reader = McapReader(tmp_path / "a.mcap")
    assert sum(message.channel.name == "scan" for message in reader.messages()) > 20
    about = reader.state.metadata["hallway"]
    assert (about["seed"], about["robot.version"], about["robot.host"]) == ("5", "1.2", "onboard")
    assert reader.state.run_config == "nodes: {}"
    off_s = (int(about["robot.clock_ahead_ns"]) - 3_600_000_000_000) / 1e9
    assert abs(off_s) <= int(about["robot.clock_ahead_error_ns"]) / 1e9 + 0.05  # two clocks of one machine


def test_a_guest_keeps_the_ring_of_the_robot_there_and_one_of_its_own_here(robot, tmp_path):
    robot.invite("anna", "viewer")
    with robot:
        keeper = robot.typed("anna", "record", "--keep")
        assert keeper.communicate(timeout=60) == ("on the robot: /there/ring-kept\n", "")
        recorder = robot.typed("anna", "record", "--ring", "10", "--duration", "0.5", "--out", "a.mcap")
        _, told = recorder.communicate(timeout=60)
        assert recorder.returncode == 0, told
        keeper = robot.typed("anna", "record", "--keep", "--out", "kept")
        _, told = keeper.communicate(timeout=60)
        assert keeper.returncode == 0, told
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["a_00000000.mcap"]


def test_no_secret_is_in_a_log_a_recording_or_a_list_of_processes(robot, tmp_path):
    robot.invite("olga", "operator")
    secrets = secrets_of(tmp_path)
    assert len(secrets) >= 9
    with robot:
        recorder = robot.typed("olga", "record", "--duration", "2", "--out", "a.mcap")
        running = b""
        while recorder.poll() is None:
            running += b"".join(map(command_line, Path("/proc").glob("[0-9]*")))
            time.sleep(0.1)
        said = "".join(recorder.communicate()).encode()
        robot.invite("anna", "viewer")  # which the hub has to say something about
        end = time.monotonic() + 20
        while not (log := (tmp_path / "robot.log").read_bytes()) and time.monotonic() < end:
            time.sleep(0.1)
    assert b"runtime.supervision.hub" in running
    assert b"a.mcap" in running
    reader = McapReader(tmp_path / "a.mcap")
    recorded = b"".join(message.payload for message in reader.messages())
    recorded += repr(reader.state).encode()
    for where in (running, said, log, recorded):
        assert len(where) > 20
        assert [secret for secret in secrets if secret in where] == []


def secrets_of(folder):
    """Return pieces of every private key that was made, as PEM and as the settings of a session have it."""
    texts = [path.read_text() for path in (folder / "owner").rglob("*.key")]
    texts += [keys.Invitation.read(path).key for path in folder.rglob("paired/*.json")]
    pieces = [line for text in texts for line in text.splitlines() if not line.startswith("-----")]
    pieces += [base64.b64encode(text.encode()).decode()[60:120] for text in texts]
    return [piece.encode() for piece in pieces if len(piece) > 40]


def command_line(process):
    try:
        return (process / "cmdline").read_bytes()
    except OSError:
        return b""  # it has ended
