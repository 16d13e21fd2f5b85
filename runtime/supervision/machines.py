"""Which machine of a run this is, and which processes of the graph run on others.

Every machine is started with the same graph. The first of its `hosts` is the robot's own: the devices are
there, and whatever stops the wheels; the others lead to it as guests with the role `machine`.
"""

import os
from dataclasses import dataclass, field

from runtime.access import keys
from runtime.access.keys import Invitation
from runtime.errors import ConfigError
from runtime.graph import Graph


@dataclass(frozen=True, slots=True)
class Machine:
    """One of the machines of a run; without names where there is one alone."""

    name: str = ""
    robots: str = ""
    """Name of the robot's own."""
    elsewhere: dict[str, str] = field(default_factory=dict)
    """Name of each process that does not run here, and where it does."""

    @property
    def is_robot(self) -> bool:
        """Whether this is the robot's own."""
        return self.name == self.robots

    @property
    def mark(self) -> str:
        """What names here take on to differ from those on the robot's machine, as ROS 2 takes them."""
        return "" if self.is_robot else "_" + "".join(c if c.isalnum() else "_" for c in self.name.lower())

    def expected(self) -> str:
        """Return in words what runs elsewhere; empty if nothing does."""
        hosts = dict.fromkeys(self.elsewhere.values())
        names = {host: [n for n, there in self.elsewhere.items() if there == host] for host in hosts}
        return "; ".join(f"{', '.join(those)} from {host}" for host, those in names.items())


def this_machine(graph: Graph, named: str | None = None) -> Machine:
    """Return the machine that this is.

    Args:
        graph: Of the run.
        named: What a person says it is called; its host name if None.

    Raises:
        ConfigError: The graph does not name it.
    """
    if not graph.hosts:
        if named is not None:
            raise ConfigError(f"--host {named}: the graph names no machines; list them under hosts")
        return Machine()
    name = named or os.uname().nodename
    if name not in graph.hosts:
        listed = ", ".join(graph.hosts)
        if named is not None:
            raise ConfigError(f"--host {named}: no machine of the graph, which names {listed}")
        raise ConfigError(
            f"this machine is called {name!r}, and the graph names {listed}: say which it is with --host NAME"
        )
    robots = graph.hosts[0]
    homes = {node: spec.host or robots for node, spec in graph.nodes.items()}
    return Machine(name, robots, {node: home for node, home in homes.items() if home != name})


def invitation(robot: str, machine: Machine) -> Invitation:
    """Return what leads from here to the robot's own machine; raises ConfigError if there is nothing."""
    kept = keys.paired(robot)
    if kept is not None and kept.role == "machine":
        return kept
    had = f"is paired with robot {robot!r} as {kept.role}" if kept else f"is not paired with robot {robot!r}"
    raise ConfigError(
        f"machine {machine.name!r} {had}; on {machine.robots}: "
        f"hallway keys invite NAME --role machine, and here: hallway keys pair NAME.invitation"
    )
