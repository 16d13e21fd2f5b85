"""How far a run is, said on stderr: plain lines where there is no terminal, a bar where there is one."""

import io
import sys

import pytest

from runtime.cli import progress as module
from runtime.cli.progress import Progress


class Wall:
    """A clock that moves when told to."""

    def __init__(self):
        self.now_s = 100.0

    def monotonic(self):
        return self.now_s


@pytest.fixture
def wall(monkeypatch):
    wall = Wall()
    monkeypatch.setattr(module.time, "monotonic", wall.monotonic)
    return wall


def run(wall, scans, step_s, quiet=False, total=100):
    with Progress(total, 0.1, quiet) as progress:
        for _ in range(scans):
            wall.now_s += step_s
            progress.advance("TRACKING")
    wall.now_s += 1000.0  # saving takes its time, and is not mapping
    return progress


def test_plain_lines_come_every_five_seconds_with_speed_and_time_left(wall, capsys):
    run(wall, 25, 0.5)
    assert capsys.readouterr().err.splitlines() == [
        "10 of 100 scans, 2 scans/s, 0.2 x real time, 0:45 left  TRACKING",
        "20 of 100 scans, 2 scans/s, 0.2 x real time, 0:40 left  TRACKING",
    ]


def test_the_speed_is_that_of_the_scans_alone(wall):
    progress = run(wall, 50, 0.02)
    assert progress.elapsed_s == pytest.approx(1.0)
    assert progress.scans_per_s == pytest.approx(50.0)
    assert progress.times_real_time == pytest.approx(5.0)


def test_a_machine_gets_no_progress(wall, capsys):
    run(wall, 100, 1.0, quiet=True)
    assert capsys.readouterr().err == ""


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_gets_one_bar_that_is_gone_afterwards(wall, monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    run(wall, 30, 0.5)
    painted = terminal.getvalue()
    assert "30/100" in painted
    assert "2 scans/s" in painted
    assert painted.rstrip().endswith(("\x1b[2K", "\x1b[?25h"))
