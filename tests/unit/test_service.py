"""The systemd unit of a robot is one that systemd takes, and systemd is told what it waits for."""

import shutil
import socket
import subprocess

import pytest

from runtime import service
from runtime.errors import ConfigError
from runtime.realtime import notify_init


def test_the_unit_starts_the_graph_and_watches_it(tmp_path):
    graph = tmp_path / "my graph.yaml"
    text = service.unit(graph, "robot", tmp_path, "nobody", ["--remote"])
    assert f"up '{graph}' --headless --robot robot --remote" in text
    assert "Type=notify" in text
    assert "WatchdogSec=10" in text
    assert "User=nobody" in text
    assert "User=root" not in text


def test_systemd_finds_nothing_wrong_with_the_unit(tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze")
    text = service.unit(tmp_path / "g.yaml", "robot", tmp_path, "root", [])
    path = service.install(text, "robot", tmp_path)
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(path)], capture_output=True, text=True, check=False
    )
    complaints = [line for line in done.stderr.splitlines() if path.name in line]
    assert (done.returncode, complaints) == (0, [])


def test_what_a_unit_cannot_hold_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="a unit cannot hold"):
        service.unit(tmp_path / "50%.yaml", "robot", tmp_path, "nobody", [])


def test_a_folder_that_is_not_there_is_one_line(tmp_path):
    with pytest.raises(ConfigError, match=r"hallway-robot\.service: cannot be written: No such file"):
        service.install("x", "robot", tmp_path / "none")


@pytest.mark.parametrize("abstract", [False, True])
def test_systemd_hears_what_it_is_told(tmp_path, monkeypatch, abstract):
    name = f"hallway-test-{tmp_path.name}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(f"\0{name}" if abstract else name)
        line.settimeout(5.0)
        monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}" if abstract else name)
        assert notify_init("WATCHDOG=1")
        assert line.recv(100) == b"WATCHDOG=1"


def test_without_systemd_nobody_is_told(tmp_path, monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert not notify_init("READY=1")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    assert not notify_init("READY=1")
