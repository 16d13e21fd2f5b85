"""The live table of a robot, frame by frame."""

import io
import sys

import pytest
from rich.console import Console

from runtime.cli.screen import Screen
from runtime.process.status import Status

HOPS = {"match": {"p50": 3.0, "p99": 8.0, "max": 9.0}}


def status(hops_ms):
    rates = {"scan": 10.0}
    return Status(
        robot="robot",
        tracking="TRACKING",
        map_size="",
        scans=5,
        mapped=5,
        rates_hz=rates,
        hops_ms=hops_ms,
        processes=(),
    )


class Frames(list):
    """Stands in for rich's live display, and keeps what it was given as text."""

    def __call__(self, **options):
        return self

    def start(self):
        pass

    def stop(self):
        pass

    def update(self, renderable, refresh):
        console = Console(width=120, record=True, file=io.StringIO())
        console.print(renderable)
        self.append(console.export_text())


@pytest.fixture
def frames(monkeypatch):
    shown = Frames()
    monkeypatch.setattr("rich.live.Live", shown)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr("runtime.cli.screen._PAINT_EVERY_S", 0.0)
    return shown


def test_the_last_frame_keeps_the_hops_that_whoever_measures_them_told_before_it_left(frames):
    with Screen() as screen:
        screen.show(status(HOPS), 1.0)
        screen.show(status({}), 2.0)
    assert len(frames) == 2
    assert all("scan published to odom published" in frame and "8.0" in frame for frame in frames)
