"""A spare process stands aside while it imports, unless it was called already."""

import os
import textwrap

import pytest

from runtime import process

NODE = """
    from dataclasses import dataclass
    SUBSCRIBES = PUBLISHES = ()
    @dataclass(frozen=True, slots=True, kw_only=True)
    class Config:
        pass
    def run(port, config):
        return 0
"""


@pytest.fixture
def stages(tmp_path, monkeypatch):
    """Return how a spare process was scheduled, given whether it is called at once."""
    (tmp_path / "spare_nodes").mkdir()
    (tmp_path / "spare_nodes" / "idle.py").write_text(textwrap.dedent(NODE))
    (tmp_path / "g.yaml").write_text("nodes: {a: {module: spare_nodes.idle}}")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv(process.PARENT_VARIABLE, raising=False)
    monkeypatch.setattr("runtime.process.signal.signal", lambda *_: None)
    monkeypatch.setattr("runtime.process.realtime.schedule", lambda *_, **__: None)

    def run(called):
        steps = []
        reading, writing = os.pipe()

        def step_aside():
            steps.append("aside")
            os.write(writing, b"go\n")  # only now
            return True

        monkeypatch.setattr("runtime.process.realtime.step_aside", step_aside)
        monkeypatch.setattr(
            "runtime.process.realtime.step_forward", lambda pid, like: steps.append("forward")
        )
        if called:
            os.write(writing, b"go\n")
        with open(reading, encoding="ascii") as stdin:
            monkeypatch.setattr("sys.stdin", stdin)
            arguments = ["a", "--graph", str(tmp_path / "g.yaml"), "--run-dir", str(tmp_path), "--spare"]
            assert process.main(arguments) == 0
        os.close(writing)
        return steps

    return run


def test_who_only_stands_by_leaves_the_processor_to_others(stages):
    assert stages(called=False) == ["aside", "forward"]


def test_who_is_called_before_it_has_imported_anything_hurries(stages):
    assert stages(called=True) == []
