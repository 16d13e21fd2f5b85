"""Who waits for long is told why; who does not wait hears nothing."""

import threading

from runtime.cli import patience


def test_a_line_is_said_while_something_takes_long(monkeypatch):
    monkeypatch.setattr(patience, "LONG_S", 0.01)
    heard = threading.Event()
    lines = []
    with patience.told(lambda line: (lines.append(line), heard.set()), "still loading"):
        assert heard.wait(10.0)
    assert lines == ["still loading"]


def test_what_is_quick_is_not_talked_about():
    lines = []
    with patience.told(lines.append, "still loading"):
        pass
    waiting = [t for t in threading.enumerate() if isinstance(t, threading.Timer)]
    assert all(timer.finished.is_set() for timer in waiting)
    assert lines == []
