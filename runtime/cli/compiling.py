"""The inner loops, compiled before anything needs them: once on a machine, on all of its cores.

Importing a module of `processing` compiles its loops if numba finds no compiled ones on disk. What is left to
the processes of a robot is compiled by several of them at once, each all of it.
"""

import hashlib
import importlib
import importlib.util
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from runtime.cli.patience import told
from runtime.clock import Clock
from runtime.supervision.supervisor import child_environment

CHAINS: tuple[tuple[float, tuple[str, ...]], ...] = (
    (8.5, ("dpslam.grid", "dpslam.laser_model", "dpslam.writing", "dpslam.alignment", "dpslam.kernels")),
    (
        13.5,
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
    (3.5, ("smoothing_kernels",)),
    (2.2, ("wide_match_kernels",)),
    (2.2, ("saliency_kernels",)),
    (2.2, ("dpslam.ancestry",)),
    (4.0, ("walker_kernels",)),
)
"""CPU seconds that each chain takes, of which only the ratios count; and its modules of `processing`,
who uses another's loops after it."""
_SAY_EVERY_S = 3.0
_WORK = "import importlib, sys\nfor m in sys.argv[1:]: importlib.import_module(m); print(m, flush=True)"


def compile_all(environment: Mapping[str, str], say: Callable[[str], None]) -> None:
    """Compile whatever was never compiled on this machine, and tell how far it is.

    A loop that does not compile is none of this function's business: whoever needs it raises its error.

    Args:
        environment: Of the processes that will need the loops; says where numba keeps them.
        say: Takes a line for people.
    """
    chains = [(cost, tuple(m for m in chain if not _compiled(m, environment))) for cost, chain in CHAINS]
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
    with told(say, "still loading the inner loops; what was never compiled here is compiled now ..."):
        importlib.import_module("processing.slam")


def share(chains: list[tuple[float, tuple[str, ...]]], workers: int) -> list[list[str]]:
    """Deal chains out to at most so many workers, the longest first, each to whoever has least to do."""
    heaps: list[tuple[float, list[str]]] = [(0.0, []) for _ in range(min(workers, len(chains)))]
    for cost, chain in sorted(chains, key=lambda pair: -pair[0]):
        least = min(range(len(heaps)), key=lambda k: heaps[k][0])
        names = [f"processing.{module}" for module in chain]
        heaps[least] = (heaps[least][0] + cost, heaps[least][1] + names)
    return [names for _, names in heaps]


def _compiled(module: str, environment: Mapping[str, str]) -> bool:
    """Whether numba has something on disk that is newer than the module."""
    spec = importlib.util.find_spec("processing")
    if spec is None or not spec.submodule_search_locations:
        return True
    source = Path(spec.submodule_search_locations[0], *module.split(".")).with_suffix(".py")
    since = source.stat().st_mtime
    return any(index.stat().st_mtime >= since for index in _indices(source, environment))


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
