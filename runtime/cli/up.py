"""Start a robot, show its processes, keep what they leave.

The robot is a graph: demo, handheld, onboard, or a YAML file.
"""

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.cli.parsing import read_address
from runtime.cli.stopping import asked_to_stop
from runtime.cli.up_end import exit_code, in_short, save, say

if TYPE_CHECKING:
    from runtime.graph import Graph
    from runtime.supervision.machines import Machine
    from runtime.supervision.run import Run

_TURN_S = 0.05
_NOTIFY_S = 0.5
_TELL_S = 2.0
_ORDINARY = ("starts", "ready", "ended")
"""What every process does once in a run."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("graph", help="demo, handheld, onboard, or a YAML file")
    parser.add_argument("--headless", action="store_true", help="leave out what needs a screen")
    parser.add_argument(
        "--duration", type=float, metavar="S", help="end by itself after S seconds of running"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="results folder (default results/TIME)")
    parser.add_argument(
        "--on",
        type=Path,
        metavar="SESSION",
        help="begin somewhere on a saved map, a session file or results folder, and follow the laser there",
    )
    parser.add_argument("--extend", action="store_true", help="with --on: map the drive onto the saved map")
    parser.add_argument("--robot", metavar="NAME", help="instead of the graph's")
    parser.add_argument("--seed", type=int, metavar="N", help="instead of the graph's")
    parser.add_argument(
        "--host", metavar="NAME", help="which machine of the graph this is (default its host name)"
    )
    parser.add_argument(
        "--remote",
        nargs="?",
        const="",
        type=read_address,
        metavar="ADDRESS[:PORT]",
        help="let guests with keys in, at this address (default all addresses, port 7448)",
    )
    parser.add_argument(
        "--service",
        nargs="?",
        const="/etc/systemd/system",
        metavar="DIR",
        help="do not start: write a systemd unit that does at boot",
    )
    parser.add_argument(
        "--enable", action="store_true", help="with --service: start it now, and at every boot"
    )
    parser.add_argument("--json", action="store_true", help="machine-readable, one object at the end")


def run(args: argparse.Namespace) -> int:
    """Run the graph; 0 when done, 130 after Ctrl-C with everything saved, else why it failed."""
    from runtime import graph as graphs
    from runtime.errors import ConfigError
    from runtime.formats.session import check_session
    from runtime.graph_on_map import on_map

    file = graphs.find(args.graph)
    if args.enable and args.service is None:
        raise ConfigError("--enable: needs --service, the unit that is to be started")
    if args.on is None:
        if args.extend:
            raise ConfigError("--extend: needs --on SESSION, the map to go on with")
        return _runs(args, file)
    if args.service is not None:
        raise ConfigError("--on with --service: give the mapper of a graph the session, and install that")
    check_session(args.on)
    with tempfile.TemporaryDirectory(prefix="hallway-") as folder:
        return _runs(args, on_map(file, args.on, args.extend, Path(folder)))


def _runs(args: argparse.Namespace, file: Path) -> int:
    """Run the graph, and again as often as the robot, on another machine, has begun a new run meanwhile."""
    while (code := _run(args, file)) is None:
        pass
    return code


def _run(args: argparse.Namespace, file: Path) -> int | None:
    """Run the graph once; None if that is to begin anew."""
    from runtime import graph as graphs
    from runtime import rundir
    from runtime.access import keys
    from runtime.bus.zenoh_bus import ZenohBus
    from runtime.cli.screen import Screen
    from runtime.config import to_yaml
    from runtime.process.realtime import is_watched
    from runtime.reports.results import check_free
    from runtime.supervision import machines
    from runtime.supervision.run import Run

    headless = args.headless or not graphs.has_screen()
    graph = _graph(args, file, headless)
    machine = machines.this_machine(graph, args.host)
    remote = _door(args.remote, machine)
    if args.service is None:  # under sudo the keys would be looked for in another home
        if remote:
            keys.authority(graph.robot)
        if not machine.is_robot:
            machines.invitation(graph.robot, machine)
    resolved = _check(file, headless, machine)
    if args.service is not None:
        return _install(file, graph.robot, args, machine)
    out = args.out or Path("results") / time.strftime("%Y%m%d-%H%M%S")
    check_free(out)
    with rundir.claimed(graph.robot) as run_dir, Screen(quiet=args.json) as screen:
        _empty(out)
        if headless and not args.headless:
            screen.say("no screen here: running as with --headless")
        screen.say(f"{graph.robot}: {len(resolved)} processes of {file.name}; results in {out}/")
        if machine.elsewhere:
            screen.say(f"expects {machine.expected()}")
        config = _resolved_config(graph, resolved)
        (run_dir / "config.yaml").write_text(to_yaml(config), encoding="utf-8")  # for the recorder
        live = Run(
            graph,
            file,
            run_dir,
            out,
            remote=remote,
            machine=machine,
            open_bus=ZenohBus,
            on_event=lambda event: screen.say(
                f"  {event.node}: {in_short(live, event)}", ordinary=event.text in _ORDINARY
            ),
        )
        try:
            asked = _drive(live, screen, args.duration)
        finally:
            live.close()
        code = exit_code(live, signal.SIGINT in asked)
        report = save(live, config, out, args, code)
    screen.check_read()
    say(report, args.json)
    # systemd, whose patience has ended with this run, begins a new one itself.
    anew = live.outlived and code == 0 and not asked and not is_watched()
    return None if anew else code


def _graph(args: argparse.Namespace, file: Path, headless: bool) -> "Graph":
    """Return the graph of a file as the options have it."""
    from dataclasses import replace

    from runtime import graph as graphs
    from runtime.errors import ConfigError

    if args.duration is not None and not args.duration > 0:
        raise ConfigError(f"--duration = {args.duration:g}, must be more than 0 s")
    graph = graphs.load(file)
    changes = {key: getattr(args, key) for key in ("robot", "seed") if getattr(args, key) is not None}
    try:
        graph = replace(graph, **changes)
    except ValueError as error:
        raise ConfigError(f"--{error}") from error
    return graph.without_screen() if headless else graph


def _door(address: str | None, machine: "Machine") -> str:
    """Return address and port at which guests are let in; empty if nobody is.

    Args:
        address: As it was asked for: empty for all addresses, None if it was not.
        machine: This one; the robot's own lets those in that have a part of it.
    """
    from runtime.access import keys
    from runtime.errors import ConfigError

    if address is not None and not machine.is_robot:
        raise ConfigError(f"--remote: guests are let in on the robot's own machine, {machine.robots}")
    if not machine.is_robot or (address is None and not machine.elsewhere):
        return ""
    address = address or "0.0.0.0"
    return address if ":" in address else f"{address}:{keys.PORT}"


def _install(file: Path, robot: str, args: argparse.Namespace, machine: "Machine") -> int:
    from runtime.supervision import service

    extra = [] if args.remote is None else ["--remote", *([args.remote] if args.remote else [])]
    extra += [] if args.host is None else ["--host", args.host]
    folder = (args.out or Path("results")).absolute()
    text = service.unit(
        file.absolute(), robot, folder.parent, service.owner(), extra, again=not machine.is_robot
    )
    path = service.install(text, robot, Path(args.service))
    if args.enable:
        service.enable(path)
        print(f"{path}: written; runs, and will at every boot; systemctl status {path.stem} says how it is")
    else:
        print(f"{path}: written; now: systemctl daemon-reload && systemctl enable --now {path}")
    return 0


def _check(file: Path, headless: bool, machine: "Machine") -> dict[str, Any]:
    """Check every node here in a process of its own, as modules are heavy and this one is light; compile."""
    from runtime.cli.compiling import UNCOMPILED, compile_all
    from runtime.cli.patience import told
    from runtime.clock import Clock
    from runtime.errors import ConfigError, HallwayError
    from runtime.supervision.supervisor import child_environment

    command = [sys.executable, "-m", "runtime.graph", str(file)]
    if headless:
        command.append("--headless")
    command += ["--elsewhere", *machine.elsewhere] if machine.elsewhere else []
    environment = child_environment(Clock())
    with told(_tell, "still loading the modules of the graph ..."):
        check = subprocess.run(command, capture_output=True, text=True, env={**environment, **UNCOMPILED})
    if check.returncode == 0:
        compile_all(environment, _tell)
        return dict(json.loads(check.stdout))
    lines = check.stderr.strip().splitlines() or [f"exit code {check.returncode}"]
    if check.returncode == ConfigError.exit_code:
        raise ConfigError(lines[-1])
    raise HallwayError(f"{file}: the check failed: {lines[-1]}")


def _tell(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _empty(out: Path) -> None:
    """Make the folder of the results; an older one of that name is kept beside it."""
    import shutil

    from runtime.reports.results import RUN_FILE, to_json

    if out.is_dir() and any(out.iterdir()):
        old = out.with_name(f"{out.name}.old")
        shutil.rmtree(old, ignore_errors=True)
        out.replace(old)
    out.mkdir(parents=True, exist_ok=True)
    # A run that is cut off leaves a folder that says so, and may be replaced.
    (out / RUN_FILE).write_text(to_json({"finished": False}), encoding="utf-8")


def _drive(live: "Run", screen: Any, duration_s: float | None) -> list[int]:
    """Turn until everything has ended; return the signals that came."""
    from runtime.process.realtime import notify_init

    running_since: float | None = None
    is_up = ends = False
    notified = told = 0.0
    with asked_to_stop(numbers=(signal.SIGINT, signal.SIGTERM, signal.SIGHUP)) as asked:
        while not live.supervisor.over:
            live.step()
            if len(asked) > 2:  # here, not in the handler: that may come in the middle of looking
                live.supervisor.close()
            now = time.monotonic()
            if now - notified > _NOTIFY_S:
                notified = now
                notify_init("WATCHDOG=1")
            if not is_up and live.supervisor.all_here:
                is_up = True  # for systemd, which would not wait for another machine
                notify_init("READY=1")
            if running_since is None and live.supervisor.all_ready:
                running_since = now
                screen.say(f"all processes run after {live.elapsed_s:.1f} s")
            over = duration_s is not None and running_since is not None and now - running_since > duration_s
            if asked or over or live.supervisor.idle or screen.unread:
                live.supervisor.stop()
            if live.supervisor.stopping and not ends:
                ends = True  # whatever the reason: saving takes longer than a watchdog waits
                notify_init("STOPPING=1")
            if (lingering := live.supervisor.lingering) and now - told > _TELL_S:
                told = now
                for name, left_s in lingering.items():
                    screen.say(f"  {name}: saves what it has; {max(0.0, left_s):.0f} s more at most")
            screen.show(live.status(), live.elapsed_s)
            time.sleep(_TURN_S)
    return asked


def _resolved_config(graph: "Graph", resolved: dict[str, Any]) -> dict[str, Any]:
    nodes = {name: node["config"] for name, node in resolved.items()}
    return {"robot": graph.robot, "domain": graph.domain, "seed": graph.seed, "nodes": nodes}
