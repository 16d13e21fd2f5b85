"""The list of what is compiled first is whole, and the work is dealt out evenly."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.caching import _CacheLocator

from runtime.cli import compiling, replay_map, up
from runtime.errors import ConfigError
from runtime.supervision.machines import Machine

PROCESSING = Path(__file__).parents[2] / "processing"
ON_DEMAND = {"sharpness"}  # of `hallway evaluate` only


def test_every_module_with_compiled_loops_is_compiled_before_a_start():
    written = {
        ".".join(file.relative_to(PROCESSING).with_suffix("").parts)
        for file in PROCESSING.rglob("*.py")
        if "@njit" in file.read_text()
    }
    listed = [module for _, chain in compiling.CHAINS for module in chain]
    assert sorted(listed) == sorted(written - ON_DEMAND)


def test_a_chain_stays_together_and_the_longest_have_a_worker_each():
    chains = [(1.0, ("a",)), (5.0, ("b", "c")), (3.0, ("d",)), (1.5, ("e",))]
    assert compiling.share(chains, 2) == [
        ["processing.b", "processing.c"],
        ["processing.d", "processing.e", "processing.a"],
    ]
    assert len(compiling.share(chains, 16)) == 4


def test_loops_are_compiled_where_the_processes_look_for_them_and_only_once(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling, "CHAINS", ((1.0, ("evolution_kernels",)),))
    monkeypatch.setattr(compiling.importlib.util, "find_spec", lambda name: _Spec(tmp_path / name))
    copy = tmp_path / "processing"
    copy.mkdir()
    for name in ("__init__.py", "evolution_kernels.py"):
        (copy / name).write_bytes((PROCESSING / name).read_bytes())
    environment = {
        **os.environ,
        "PYTHONPATH": str(tmp_path),
        "PYTHONSAFEPATH": "1",
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
    }
    said = []

    def times_compiled():
        compiling.compile_all(environment, said.append)
        return sum(line.startswith("compiling") for line in said)

    assert times_compiled() == 1
    assert any((tmp_path / "cache").rglob("evolution_kernels.*.nbi"))
    assert times_compiled() == 1
    os.utime(copy / "evolution_kernels.py")  # as an upgrade does
    assert times_compiled() == 2


def test_loops_count_as_compiled_only_where_numba_will_look_for_them(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling.importlib.util, "find_spec", lambda name: _Spec(tmp_path / name))
    source = tmp_path / "processing" / "evolution_kernels.py"
    source.parent.mkdir()
    source.touch()
    python = f"py{sys.version_info.major}{sys.version_info.minor}"
    beside, elsewhere = source.parent / "__pycache__", tmp_path / "cache"

    def compiled(**environment):
        return not compiling._outdated(("evolution_kernels",), environment)

    def put(folder, name=f"evolution_kernels.mutate-12.{python}.nbi"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()

    put(elsewhere / f"processing_{'0' * 40}")  # another checkout's
    put(beside, "evolution_kernels.mutate-12.py27.nbi")  # another Python's
    assert not compiled()
    assert not compiled(NUMBA_CACHE_DIR=str(elsewhere))
    put(beside)
    assert compiled()
    assert not compiled(NUMBA_CACHE_DIR=str(elsewhere))
    put(elsewhere / _CacheLocator.get_suitable_cache_subpath(str(source)))
    assert compiled(NUMBA_CACHE_DIR=str(elsewhere))


def test_what_was_compiled_before_a_loop_that_it_uses_is_compiled_again(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling.importlib.util, "find_spec", lambda name: _Spec(tmp_path / name))
    python = f"py{sys.version_info.major}{sys.version_info.minor}"
    beside = tmp_path / "processing" / "__pycache__"
    beside.mkdir(parents=True)
    chain = ("ndt_kernels", "matching_kernels")
    for age_s, module in zip((200, 100), chain, strict=True):
        source, index = beside.parent / f"{module}.py", beside / f"{module}.loop-12.{python}.nbi"
        for file in (source, index):
            file.touch()
            os.utime(file, (1e9 - age_s, 1e9 - age_s))
    assert compiling._outdated(chain, {}) == ()
    # An upgrade brings the callee alone; numba would not see that its caller has the old one inside.
    os.utime(beside.parent / "ndt_kernels.py", (1e9, 1e9))
    assert compiling._outdated(chain, {}) == chain
    assert not list(beside.glob("*.nbi"))


def test_reading_a_configuration_compiles_nothing(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "runtime.cli", "config", "check", "demo"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=PROCESSING.parent)
    assert (done.returncode, done.stderr) == (0, "")
    assert list(tmp_path.rglob("*.nbi")) == []


def test_what_was_said_of_compiling_is_said_again_when_modules_are_loaded(monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "0")
    with compiling.uncompiled():
        assert os.environ["NUMBA_DISABLE_JIT"] == "1"
    assert os.environ["NUMBA_DISABLE_JIT"] == "0"
    monkeypatch.delenv("NUMBA_DISABLE_JIT")
    with compiling.uncompiled():
        pass
    assert "NUMBA_DISABLE_JIT" not in os.environ


@pytest.mark.parametrize("config", ["{}", "{odometry: {key_scans: 0}}"])
def test_a_robot_is_compiled_once_its_graph_is_known_to_be_good(config, tmp_path, monkeypatch):
    compiled = []
    monkeypatch.setattr(compiling, "compile_all", lambda environment, say: compiled.append(environment))
    graph = tmp_path / "graph.yaml"
    graph.write_text(f"robot: r\nnodes:\n  matcher: {{module: matcher, config: {config}}}\n")
    if config == "{}":
        assert up._check(graph, True, Machine())["matcher"]["publishes"]
        assert "NUMBA_DISABLE_JIT" not in compiled[0]
    else:
        with pytest.raises(ConfigError, match="key_scans"):
            up._check(graph, True, Machine())
        assert compiled == []


def test_a_recording_that_is_mapped_again_waits_for_the_loops_before_its_processes_start(
    tmp_path, monkeypatch
):
    def compile_all(environment, say):
        say("compiling")
        raise InterruptedError

    monkeypatch.setattr(compiling, "compile_all", compile_all)
    with pytest.raises(InterruptedError):
        replay_map._run(tmp_path / "graph.yaml", tmp_path / "out", None, quiet=True)
    assert not (tmp_path / "out").exists()


class _Spec:
    def __init__(self, place):
        self.submodule_search_locations = [str(place)]
