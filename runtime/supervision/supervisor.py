"""Start the processes of a graph in order, watch them, start them again, stop them all within two seconds.

The supervisor has one thread and no patience: `step` looks once at everything and returns. It knows
processes, the names of those that are ready and those that are silent, and when the loop of each has turned;
where these come from is not its business.
"""

import os
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from runtime.clock import OFFSET_VARIABLE, Clock
from runtime.graph import Graph, NodeSpec
from runtime.process import realtime
from runtime.supervision.child import Child, State

HUB = "hub"
_DONE = (State.ENDED, State.FAILED)
_ASKED = (State.STOPPING, *_DONE)
_ROTATE_S = 5.0
_WAVES_S = 0.4
"""For so long those are asked first that others do not wait for; then everybody is asked at once."""
_LINGERS_S = 1.0
SILENT_S = 5.0
"""A process that beats once a second and was not heard for so long does not work."""
_STALL_S = 1.0
"""Whoever did not look for so long was stopped, or starved; it hears others again when its links are back."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened to a process."""

    stamp_ns: int
    node: str
    text: str


class Supervisor:
    """The processes of one run.

    Args:
        graph: What to run. commands: The command line of each node, and of the hub. logs: Folder for one
        log a process. clock: Of this run; handed to every process. on_event: Hears of everything that
        happens. forget: Is told the name of a process that starts, so that its predecessor's signs of life
        do not count. elsewhere: Processes of the graph that run on other machines: waited for, and no more.
    """

    def __init__(
        self,
        graph: Graph,
        commands: Mapping[str, Sequence[str]],
        logs: Path,
        clock: Clock,
        on_event: Callable[[Event], None] = lambda event: None,
        forget: Callable[[str], None] = lambda name: None,
        elsewhere: Collection[str] = (),
    ) -> None:
        self._clock, self._on_event, self._forget = clock, on_event, forget
        environment = child_environment(clock)
        logs.mkdir(parents=True, exist_ok=True)
        specs = {name: graph.nodes[name] for name in graph.order() if name not in elsewhere}
        if HUB in commands:
            specs = {HUB: NodeSpec(module="runtime.supervision.hub", restart="always"), **specs}
        self.children = {
            name: Child(name, spec, commands[name], logs / f"{name}.log", environment)
            for name, spec in specs.items()
        }
        self._elsewhere, self._met = set(elsewhere), set[str]()
        self.stopping = False
        self._stop_began = 0.0
        self._rotated = 0.0
        self._looked = self._attentive = time.monotonic()
        self.failed: Child | None = None
        """The required process whose end ended the run."""

    @property
    def all_ready(self) -> bool:
        """Whether every process is up, or has done its work."""
        return all(child.state in (State.RUNNING, State.ENDED) for child in self.children.values())

    @property
    def all_here(self) -> bool:
        """Whether every process is up but those that wait, directly or not, for another machine."""
        far: set[str] = set()
        for child in self.children.values():  # each comes after those it waits for
            unmet = [name for name in child.spec.after if name not in self.children and name not in self._met]
            if child.state is State.WAITING and (unmet or far.intersection(child.spec.after)):
                far.add(child.name)
        return all(
            child.state in (State.RUNNING, State.ENDED) or child.name in far
            for child in self.children.values()
        )

    @property
    def over(self) -> bool:
        """Whether nothing runs, and nothing will."""
        return self.stopping and all(child.state in _DONE for child in self.children.values())

    @property
    def idle(self) -> bool:
        """Whether every process but the hub has ended on its own."""
        return all(child.state in _DONE for child in self.children.values() if child.name != HUB)

    @property
    def lingering(self) -> dict[str, float]:
        """Processes that were asked to end a while ago, and how many seconds they still may take."""
        return {
            child.name: child.spec.stop_s - child.age_s
            for child in self.children.values()
            if child.state is State.STOPPING and child.age_s > _LINGERS_S
        }

    def step(
        self,
        ready: Collection[str],
        silent: Collection[str] = (),
        loop_ages_s: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Look once after every process; call it some twenty times a second.

        Args:
            ready: Names of the processes that say they are ready.
            silent: Names of the processes that have not been heard of for too long.
            loop_ages_s: How long ago the loops of the others have turned, by their own account.
        """
        self._met |= self._elsewhere.intersection(ready)
        if self._is_deaf():
            silent, loop_ages_s = (), {}
        for child in self.children.values():
            if child.state is State.STARTING and child.name in ready:
                child.ready()
                self._tell(child, "ready")
            elif child.state is State.RUNNING and child.age_s > SILENT_S and not child.dying:
                if child.name in silent:
                    self._tell(child, child.kill("does not speak any more"))
                elif loop_ages_s.get(child.name, 0.0) > child.spec.turn_s:
                    self._tell(child, child.kill(f"its loop has not turned for {child.spec.turn_s:g} s"))
            while (happened := child.poll()) is not None:  # one that was buried may start in the same turn
                if child.state is State.STARTING:
                    self._forget(child.name)
                self._tell(child, happened)
            if child.state is State.WAITING and not self.stopping and self._may_start(child):
                self._tell(child, child.start())
            if child.state is State.FAILED and child.spec.required and self.failed is None:
                self.failed = child
                self.stop()
        if self.stopping:
            self._press()
        if time.monotonic() - self._rotated > _ROTATE_S:
            self._rotated = time.monotonic()
            for child in self.children.values():
                child.rotate_log()

    def stop(self) -> None:
        """Ask everything to end; `step` goes on until `over`. The hub hears everybody's last word."""
        if self.stopping:
            return
        self.stopping = True
        for child in self.children.values():
            child.for_good = True
        self._stop_began = time.monotonic()

    def close(self) -> None:
        """End everything at once, whatever state it is in."""
        for child in self.children.values():
            child.end()

    def _is_deaf(self) -> bool:
        """Whether this process did not run itself a while ago, and others spoke without being heard."""
        now = time.monotonic()
        if now - self._looked > _STALL_S:
            self._attentive = now
        self._looked = now
        return now - self._attentive < SILENT_S

    def _may_start(self, child: Child) -> bool:
        hub = self.children.get(HUB)
        if hub is not None and child is not hub and hub.state is not State.RUNNING:
            return False
        return all(self._was_ready(name) for name in child.spec.after)

    def _was_ready(self, name: str) -> bool:
        child = self.children.get(name)
        return name in self._met if child is None else child.was_ready or child.state in _DONE

    def _press(self) -> None:
        """Ask everything to end, whoever listens before whoever speaks; then insist."""
        hurry = time.monotonic() - self._stop_began > _WAVES_S
        for child in self.children.values():
            if child.state in _ASKED or child.name == HUB:
                continue
            later = (c for c in self.children.values() if child.name in c.spec.after)
            if hurry or all(c.state in _DONE for c in later):
                child.stop()
        hub = self.children.get(HUB)
        if hub is not None and hub.state not in _ASKED and self.idle:
            hub.stop()
        for child in self.children.values():
            if (happened := child.press()) is not None:
                self._tell(child, happened)

    def _tell(self, child: Child, text: str) -> None:
        self._on_event(Event(self._clock.now_ns(), child.name, text))


def commands(
    graph: Graph,
    file: Path,
    run_dir: Path,
    results_dir: Path,
    *,
    remote: str = "",
    lead: bool = False,
    python: str = sys.executable,
) -> dict[str, list[str]]:
    """Return the command line of the hub and of every node; each node has its own folder of the results.

    Args:
        graph: What runs.
        file: Where it was read from.
        run_dir: Of the robot's sockets.
        results_dir: Holds a folder for each node.
        remote: `address:port` at which the hub lets guests in; nowhere if empty.
        lead: Whether the hub leads on to the robot's, on another machine.
        python: The interpreter.
    """
    lines = {HUB: [python, "-m", "runtime.supervision.hub", "--run-dir", str(run_dir)]}
    lines[HUB] += ["--robot", graph.robot, "--domain", str(graph.domain)]
    lines[HUB] += ["--remote", remote] * bool(remote) + ["--lead"] * lead
    for name in graph.nodes:
        lines[name] = [
            *(python, "-m", "runtime.process", name, "--graph", str(file), "--run-dir", str(run_dir)),
            *("--results-dir", str(results_dir / name), "--robot", graph.robot, "--seed", str(graph.seed)),
        ]
    return lines


def child_environment(clock: Clock) -> dict[str, str]:
    """Return the environment of every process of a run."""
    environment = {**os.environ, **realtime.THREAD_LIMITS, **realtime.MEMORY_LIMITS}
    environment[OFFSET_VARIABLE] = str(clock.offset_ns)
    environment[realtime.PARENT_VARIABLE] = str(os.getpid())
    package = Path(__file__).resolve().parents[2]
    # Ours before whatever is called `runtime` where the person stands; what is only there is found as well.
    environment["PYTHONSAFEPATH"] = "1"
    places = (str(package), os.environ.get("PYTHONPATH"), os.getcwd())
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, places))
    if "NUMBA_CACHE_DIR" not in environment and not os.access(package / "processing", os.W_OK):
        home = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
        environment["NUMBA_CACHE_DIR"] = str(Path(home) / "hallway" / "numba")
    return environment
