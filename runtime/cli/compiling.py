"""The inner loops, compiled before anything needs them: once on a machine, on all of its cores.

Importing a module of `processing` compiles its loops if numba finds no compiled ones on disk. What is left to
the processes of a robot is compiled by several of them at once, each all of it.
"""

import contextlib
import hashlib
import importlib
import importlib.util
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from runtime.cli.patience import told
from runtime.clock import Clock
from runtime.supervision.supervisor import child_environment

CHAINS: tuple[tuple[float, tuple[str, ...]], ...] = (
    (9.0, ("dpslam.grid", "dpslam.laser_model", "dpslam.writing", "dpslam.alignment", "dpslam.kernels")),
    (
        12.2,
        (
            "evolution_kernels",
            "ndt_kernels",
            "wall_kernels",
            "facing_kernels",
            "sight_kernels",
            "certainty_kernels",
            "matching_kernels",
            "dpslam.settled_kernels",
        ),
    ),
    (4.9, ("smoothing_kernels",)),
    (2.0, ("wide_match_kernels",)),
    (2.2, ("saliency_kernels",)),
    (1.4, ("dpslam.ancestry",)),
    (2.8, ("walker_kernels",)),
)
"""CPU seconds that each chain takes, of which only the ratios count; and its modules of `processing`,
who uses another's loops after it."""
_SAY_EVERY_S = 3.0
UNCOMPILED = {"NUMBA_DISABLE_JIT": "1"}
"""For whoever asks modules how they are configured and runs none of their loops: they load in half the time,
and in no more where nothing was ever compiled."""
# numba makes many objects that stay: to look through them as often as usual takes a tenth of its time.
_WORK = """
import gc, importlib, sys
gc.set_threshold(50_000, 20, 100)
for m in sys.argv[1:]:
    importlib.import_module(m)
    print(m, flush=True)
"""


def compile_all(environment: Mapping[str, str], say: Callable[[str], None]) -> None:
    """Compile whatever was never compiled on this machine, and tell how far it is.

    A loop that does not compile is none of this function's business: whoever needs it raises its error.

    Args:
        environment: Of the processes that will need the loops; says where numba keeps them.
        say: Takes a line for people.
    """
    chains = [(cost, _outdated(chain, environment)) for cost, chain in CHAINS]
    total = sum(len(chain) for _, chain in chains)
    if total == 0:
        return
    say("compiling the inner loops; once on this machine, later starts find them ...")
    said = time.monotonic()
    reading, writing = os.pipe()
    workers = [
        subprocess.Popen(
            [sys.executable, "-c", _WORK, *heap], stdout=writing, stderr=subprocess.DEVNULL, env=environment
        )
        for heap in share([(cost, chain) for cost, chain in chains if chain], len(os.sched_getaffinity(0)))
    ]
    os.close(writing)
    try:
        with open(reading, encoding="utf-8") as lines:
            for done, _ in enumerate(lines, 1):
                if time.monotonic() - said > _SAY_EVERY_S:
                    said = time.monotonic()
                    say(f"compiled {done} of {total}")
    finally:
        for worker in workers:
            worker.kill()
            worker.wait()


def compile_here(verb: str) -> None:
    """Compile and load what a command needs in its own process; call it before anything imports numba."""

    def say(line: str) -> None:
        print(f"hallway {verb}: {line}", file=sys.stderr, flush=True)

    environment = child_environment(Clock())
    if "NUMBA_CACHE_DIR" in environment:
        os.environ["NUMBA_CACHE_DIR"] = environment["NUMBA_CACHE_DIR"]
    compile_all(environment, say)
    with told(say, "still loading; loops never compiled here are compiled now ..."):
        importlib.import_module("processing.slam")


@contextmanager
def uncompiled() -> Iterator[None]:
    """Load modules without their loops, as UNCOMPILED has it; no difference where numba is here already."""
    before = {name: os.environ.get(name) for name in UNCOMPILED}
    os.environ |= UNCOMPILED
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def share(chains: list[tuple[float, tuple[str, ...]]], workers: int) -> list[list[str]]:
    """Deal chains out to at most so many workers, the longest first, each to whoever has least to do."""
    heaps: list[tuple[float, list[str]]] = [(0.0, []) for _ in range(min(workers, len(chains)))]
    for cost, chain in sorted(chains, key=lambda pair: -pair[0]):
        least = min(range(len(heaps)), key=lambda k: heaps[k][0])
        names = [f"processing.{module}" for module in chain]
        heaps[least] = (heaps[least][0] + cost, heaps[least][1] + names)
    return [names for _, names in heaps]


def _outdated(chain: tuple[str, ...], environment: Mapping[str, str]) -> tuple[str, ...]:
    """Return the modules of a chain that are to be compiled: never were, or before something that they use.

    numba looks at a module's own source alone; a loop with an older callee inside would stay, so its index
    goes.
    """
    spec = importlib.util.find_spec("processing")
    if spec is None or not spec.submodule_search_locations:
        return ()
    root, newest, outdated = Path(spec.submodule_search_locations[0]), 0.0, []
    for module in chain:
        source = root.joinpath(*module.split(".")).with_suffix(".py")
        newest = max(newest, source.stat().st_mtime)
        indices = list(_indices(source, environment))
        old = [index for index in indices if index.stat().st_mtime < newest]
        for index in old:
            with contextlib.suppress(OSError):
                index.unlink()
        if old or not indices:
            outdated.append(module)
    return tuple(outdated)


def _indices(source: Path, environment: Mapping[str, str]) -> Iterator[Path]:
    """Yield numba's index files of a module from where numba will look for them, and from nowhere else."""
    pattern = f"{source.stem}.*.py{sys.version_info.major}{sys.version_info.minor}.nbi"
    if root := environment.get("NUMBA_CACHE_DIR"):
        # As numba names the folder of a module there. Our processes import us by the resolved path.
        for folder in {source.parent.absolute(), source.parent.resolve()}:
            name = f"{folder.name}_{hashlib.sha1(str(folder).encode(), usedforsecurity=False).hexdigest()}"
            yield from Path(root, name).glob(pattern)
    else:
        yield from source.parent.glob(f"__pycache__/{pattern}")
