"""The systemd unit of a robot is one that systemd takes, and systemd is told what it waits for."""

import contextlib
import os
import re
import shutil
import socket
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest

from runtime import cli, rundir
from runtime.cli import up
from runtime.errors import ConfigError, HallwayError
from runtime.process.realtime import notify_init
from runtime.supervision import service


def test_the_unit_starts_the_graph_and_watches_it(tmp_path):
    graph = tmp_path / "my graph.yaml"
    text = service.unit(graph, "robot", tmp_path, "nobody", ["--remote"])
    assert f"up '{graph}' --headless --robot robot --remote" in text
    assert "Type=notify" in text
    assert "WatchdogSec=10" in text
    assert "User=nobody" in text


def test_a_machine_that_is_not_the_robot_waits_for_it_again_when_it_has_ended(tmp_path, monkeypatch):
    monkeypatch.setenv("SUDO_USER", "nobody")
    graph = tmp_path / "g.yaml"
    graph.write_text("hosts: [pi, desk]\nnodes: {a: {module: monitor}, b: {module: mapper, host: desk}}\n")
    for host, restart in (("pi", "on-failure"), ("desk", "always")):
        assert cli.main(["up", str(graph), "--host", host, "--service", str(tmp_path)]) == 0
        text = (tmp_path / "hallway-robot.service").read_text()
        assert f"--robot robot --host {host}\n" in text
        assert f"Restart={restart}\n" in text


def test_nothing_runs_as_root(tmp_path):
    with pytest.raises(ConfigError, match="a robot does not run as root"):
        service.unit(tmp_path / "g.yaml", "robot", tmp_path, "root", [])


def test_each_unit_has_a_directory_of_its_own_where_its_robot_is_looked_for(tmp_path):
    for robot in ("left", "right"):
        text = service.unit(tmp_path / "g.yaml", robot, tmp_path, "nobody", [])
        assert f"Environment=HALLWAY_RUN=/run/hallway-{robot}\nRuntime" in re.sub("# .*\n", "", text)
        assert f"RuntimeDirectory=hallway-{robot}\n" in text
        assert rundir.boot_dir(robot) == Path(f"/run/hallway-{robot}")


def test_systemd_finds_nothing_wrong_with_the_unit(tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze")
    text = service.unit(tmp_path / "g.yaml", "robot", tmp_path, "daemon", [])
    path = service.install(text, "robot", tmp_path)
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(path)], capture_output=True, text=True, check=False
    )
    complaints = [line for line in done.stderr.splitlines() if path.name in line]
    assert (done.returncode, complaints) == (0, [])


def test_what_a_unit_cannot_hold_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="a unit cannot hold"):
        service.unit(tmp_path / "50%.yaml", "robot", tmp_path, "nobody", [])


@pytest.fixture
def systemctl(tmp_path, monkeypatch):
    """Return a function that puts a `systemctl` on PATH, and one that reads what it was told."""
    (tmp_path / "bin").mkdir()
    told = tmp_path / "told"

    def make(last=""):
        program = tmp_path / "bin" / "systemctl"
        program.write_text(f'#!/bin/sh\necho "$@" >> {told}\n{last}\n')
        program.chmod(0o755)
        monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")

    return make, lambda: told.read_text().splitlines()


def test_one_command_writes_the_unit_and_starts_it_now_and_at_every_boot(
    tmp_path, monkeypatch, systemctl, capsys
):
    make, told = systemctl
    make()
    monkeypatch.setenv("SUDO_USER", "nobody")
    assert cli.main(["up", "onboard", "--service", str(tmp_path), "--enable", "--robot", "left"]) == 0
    unit = tmp_path / "hallway-left.service"
    assert "User=nobody" in unit.read_text()
    assert told() == ["daemon-reload", f"enable --now {unit}"]
    assert f"{unit}: written; runs, and will at every boot" in capsys.readouterr().out


def test_what_systemd_refuses_is_said_in_its_own_words(tmp_path, systemctl):
    make, told = systemctl
    make('[ "$1" = enable ] && { echo "Failed: Access denied" >&2; exit 4; }; exit 0')
    with pytest.raises(HallwayError, match="written, but systemctl enable: Failed: Access denied"):
        service.enable(tmp_path / "hallway-robot.service")
    assert len(told()) == 2


def test_without_systemd_a_robot_is_not_enabled(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(HallwayError, match="written, but there is no systemctl here"):
        service.enable(tmp_path / "hallway-robot.service")


def test_enable_alone_is_a_mistake(capsys):
    assert cli.main(["up", "onboard", "--enable"]) == 2
    assert "--enable: needs --service" in capsys.readouterr().err


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


class Ending:
    """A run that ends by itself: one look, and the next one finds it over."""

    def __init__(self):
        self.supervisor, self.elapsed_s, self.looks = self, 0.0, 0
        self.stopping, self.idle, self.all_here, self.all_ready, self.lingering = True, False, True, True, {}

    @property
    def over(self):
        return self.looks > 1

    def step(self):
        self.looks += 1

    def status(self):
        return None

    def stop(self):
        """Nobody asks it to."""
        raise AssertionError


def test_systemd_hears_that_a_run_ends_whoever_ends_it(tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(tmp_path / "notify"))
        line.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        screen = SimpleNamespace(unread=False, say=lambda text: None, show=lambda *what: None)
        assert up._drive(Ending(), screen, None) == []
        told = []
        with contextlib.suppress(BlockingIOError):
            while True:
                told.append(line.recv(100).decode())
    assert told == ["WATCHDOG=1", "READY=1", "STOPPING=1"]
