"""One run of a graph from the first process to the results: supervisor, bus and results folder together.

`step` looks at everything once; whoever drives it shows what it finds and decides when to stop.
"""

import json
import logging
import os
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from runtime.bus import links
from runtime.bus.contract import Bus
from runtime.bus.offset import tell_time
from runtime.clock import Clock
from runtime.graph import Graph
from runtime.process.health import Health, Vital
from runtime.process.identity import Identity, left_in, tell
from runtime.process.log_lines import LogFormat
from runtime.process.node import BusPort
from runtime.process.status import ELSEWHERE, SUPERVISOR, Status, status_of
from runtime.supervision.machines import Machine
from runtime.supervision.supervisor import HUB, SILENT_S, Event, Supervisor, commands

_REPORT_S = 1.0
ENDS = "ends"
"""Among the values of a supervisor: whether the run ends."""
RUN = "run"
"""Among them: a name of the run that no other has."""


def log_to(file: Path) -> logging.Handler:
    """Write this process's log lines into a file; close what is returned when the run is over."""

    class Handler(logging.FileHandler):
        def close(self) -> None:
            logging.getLogger().removeHandler(self)
            super().close()

    handler = Handler(file, encoding="utf-8")
    handler.setFormatter(LogFormat())
    logging.getLogger().addHandler(handler)
    logging.getLogger().setLevel(logging.INFO)
    return handler


class Run:
    """The processes of a graph, what they say, and what they leave behind.

    Args:
        graph: What runs; checked.
        file: Where it was read from; the processes read it again.
        run_dir: Of this robot, claimed.
        results_dir: Folder of the results; each node writes into its own folder in it until `collect`.
        remote: `address:port` at which guests with keys are let in; nowhere if empty.
        machine: This one; what runs elsewhere is not started here.
        open_bus: Opens a session of this run.
        on_event: Hears of everything that happens to a process.
    """

    def __init__(
        self,
        graph: Graph,
        file: Path,
        run_dir: Path,
        results_dir: Path,
        *,
        remote: str = "",
        machine: Machine | None = None,
        open_bus: Callable[[dict[str, Any]], Bus],
        on_event: Callable[[Event], None] = lambda event: None,
    ) -> None:
        self.graph, self.run_dir, self.results_dir = graph, run_dir, results_dir
        self.clock = Clock()
        Identity.of_run(graph.seed, graph.domain, self.clock.offset_ns).leave(run_dir)
        self.began = time.monotonic()
        self.events: list[Event] = []
        self._machine = machine = machine or Machine()
        self._name = SUPERVISOR + machine.mark
        self._tell = on_event
        self._open_bus = open_bus
        self._health: Health | None = None
        self._port: BusPort | None = None
        self._reported = 0.0
        self._said_to_end = False
        self._run = os.urandom(8).hex()
        self._robots_run = ""
        self.outlived = False
        """Whether the robot, on another machine, has begun a new run while this one was part of its last."""
        logs = results_dir / "logs"
        logs.mkdir(parents=True, exist_ok=True)
        self._log = log_to(logs / f"{SUPERVISOR}.log")
        (run_dir / "logs").symlink_to(logs.absolute())
        self.supervisor = Supervisor(
            graph,
            commands(
                graph,
                file.absolute(),
                run_dir,
                results_dir.absolute(),
                remote=remote,
                lead=not machine.is_robot,
            ),
            logs,
            self.clock,
            self._note,
            self._forget,
            machine.elsewhere,
        )

    @property
    def elapsed_s(self) -> float:
        """Since the run began."""
        return time.monotonic() - self.began

    def step(self) -> None:
        """Look after everything once."""
        hub_listens = (self.run_dir / "hub.sock").exists()
        ready = {HUB} if hub_listens else set()
        silent: set[str] = set()
        loop_ages_s: dict[str, float] = {}
        if self._health is None and hub_listens:
            self._join()
        if self._health is not None:
            ready |= self._health.ready()
            silent = self._health.silent(SILENT_S)
            loop_ages_s = self._health.loop_ages_s()
        self.supervisor.step(ready, silent, loop_ages_s)
        if not self.supervisor.stopping and (why := self._end_of_robots()):
            self._note(Event(self.clock.now_ns(), self._name, why))
            self.supervisor.stop()
        if self._port is not None:
            self._port.turn()
            ending = self.supervisor.stopping and not self._said_to_end
            if ending or time.monotonic() - self._reported > _REPORT_S:
                self._report(self._port)

    def status(self) -> Status:
        """Return how the robot is."""
        return status_of(self.graph.robot, self._vitals())

    def close(self) -> None:
        """End whatever still runs and leave the bus."""
        self.supervisor.close()
        self._log.close()
        if self._port is not None:
            self._port.close()
            self._port = None

    def summary(self) -> dict[str, Any]:
        """Return what the run's file says about its processes."""
        return {
            "seconds": round(self.elapsed_s, 1),
            "processes": {
                child.name: {
                    "state": child.state.value,
                    "restarts": child.restarts,
                    "exit_code": child.exit_code,
                    "reasons": list(child.reasons),
                }
                for child in self.supervisor.children.values()
            },
        }

    def _join(self) -> None:
        config = links.peer(self.run_dir, self._name)
        bus = self._open_bus(config)
        self._port = BusPort(
            self._name, lambda: bus, robot=self.graph.robot, domain=self.graph.domain, clock=self.clock
        )
        self._health = Health(bus, self.graph.robot, self.graph.domain)
        if self._machine.is_robot:
            tell_time(bus, self.graph.robot, self.clock)
            tell(bus, self.graph.robot, left_in(self.run_dir))
        self._port.ready()

    def _report(self, port: BusPort) -> None:
        self._reported = time.monotonic()
        self._said_to_end = self.supervisor.stopping
        values: dict[str, object] = {}
        children = self.supervisor.children.values()
        for child in children:
            # There is a hub on each machine, and every other process once.
            place = f"child.{child.name}" + self._machine.mark * (child.name == HUB)
            values[f"{place}.state"] = child.state.value
            values[f"{place}.restarts"] = child.restarts
            if not self._machine.is_robot:
                values[f"{place}.host"] = self._machine.name
            if child.reasons:
                values[f"{place}.reason"] = child.reasons[-1]
            if child.name == HUB and child.pid is not None:  # every other process speaks for itself
                seen = {"pid": child.pid, **child.usage()}
                values |= {f"{place}.{name}": value for name, value in seen.items()}
        if self._machine.is_robot:
            for name, host in self._machine.elsewhere.items():
                values |= {f"child.{name}.state": ELSEWHERE, f"child.{name}.host": host}
        values[ENDS] = int(self.supervisor.stopping)
        values[RUN] = self._run
        step_ms = self.clock.wall_step_ns() / 1e6
        values["wall_clock_step_ms"] = f"{step_ms:.1f}"
        down = [c.name for c in children if c.state.value in ("backoff", "failed")]
        if down:
            port.report("error", f"down: {', '.join(down)}", **values)
        elif abs(step_ms) > 500:
            port.report("warn", f"the wall clock has stepped by {step_ms:.0f} ms; stamps did not", **values)
        else:
            port.report("ok", "stopping" if self.supervisor.stopping else "running", **values)
        if self.supervisor.stopping:
            port.beat()  # now: once the hub has ended, no other machine hears it

    def _end_of_robots(self) -> str:
        """Return how the robot's run, on another machine, has ended; empty as long as it has not."""
        robot = None if self._machine.is_robot else self._vitals().get(SUPERVISOR)
        if robot is None:
            return ""
        if robot.has_left or robot.number(ENDS) > 0:
            return "the robot has ended, and this part with it"
        run = robot.values.get(RUN, "")
        self._robots_run = self._robots_run or run
        # It was killed, or the link was cut at its last word: no map goes on from one run into the next.
        self.outlived = run != self._robots_run
        return "the robot has begun a new run: this part of its last one ends" if self.outlived else ""

    def _vitals(self) -> Mapping[str, Vital]:
        return self._health.vitals() if self._health is not None else {}

    def _note(self, event: Event) -> None:
        if len(self.events) < 10_000:
            self.events.append(event)
        logging.getLogger(event.node).info("%s", event.text)
        self._tell(event)

    def _forget(self, name: str) -> None:
        if self._health is not None:
            self._health.forget(name)


def collect(results_dir: Path, nodes: list[str], run: Mapping[str, Any], config: Any) -> dict[str, Any]:
    """Put what the nodes left in their folders together into the one results folder.

    Args:
        results_dir: Holds a folder for each node that left something.
        nodes: Their names; of two files of one name, the first node's stays where it is.
        run: What is known of the run; over what the nodes say in their `run.json`.
        config: The resolved configuration of every node.

    Returns:
        The metrics of all nodes.
    """
    from runtime.config import to_yaml
    from runtime.reports.results import RUN_FILE, to_json

    metrics: dict[str, Any] = {}
    about: dict[str, Any] = {}
    for name in nodes:
        folder = results_dir / name
        if not folder.is_dir():
            continue
        for file in sorted(folder.iterdir()):
            if file.name == "metrics.json":
                metrics |= _left_in(file)
                file.unlink()
            elif file.name == RUN_FILE:
                about |= _left_in(file)
                file.unlink()
            elif file.name == "latency.json":
                latency = _left_in(file)
                known = metrics.setdefault("latency", {})
                hops = known.get("hops", {}) | latency.get("hops", {})
                known |= {**latency, "hops": hops}
                file.unlink()
            elif file.name == "config.yaml":
                file.unlink()  # the whole graph's is written below
            elif not (results_dir / file.name).exists():
                shutil.move(file, results_dir / file.name)
        if not any(folder.iterdir()):
            folder.rmdir()
    (results_dir / "config.yaml").write_text(to_yaml(config), encoding="utf-8")
    (results_dir / "metrics.json").write_text(to_json(metrics), encoding="utf-8")
    (results_dir / RUN_FILE).write_text(to_json({**about, **run}), encoding="utf-8")
    return metrics


def _left_in(file: Path) -> dict[str, Any]:
    """Return what a node wrote; nothing where it was ended meanwhile, which costs no other its results."""
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
    except ValueError:
        logging.getLogger(SUPERVISOR).warning("%s: is cut off, and left out of the results", file)
        return {}
    return dict(values)
