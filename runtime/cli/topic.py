"""List topics of a robot, print messages, measure rate and delay."""

import argparse
import sys
import time
from typing import TYPE_CHECKING, Any

from runtime.cli.fitting import fitted
from runtime.cli.parsing import number, whole_number
from runtime.cli.which_robot import add_robot
from runtime.errors import ConfigError

if TYPE_CHECKING:
    from runtime import messages


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    actions.add_parser("list", help="names, types, and who publishes and reads them")
    for name, text in (
        ("echo", "print the messages of a topic"),
        ("hz", "measure the rate of a topic"),
        ("delay", "measure the time from a message's stamp to its arrival"),
    ):
        action = actions.add_parser(name, help=text, description=text)
        action.add_argument("topic", help="of the robot, as `scan`, or any other by its whole name")
        action.add_argument(
            "-n", "--count", type=whole_number(0), default=0, help="end after so many messages"
        )
        action.add_argument(
            "--within", type=number(least=0.0), default=0.0, metavar="S", help="end after S seconds"
        )
        if name == "echo":
            action.add_argument("--full", action="store_true", help="arrays in whole, however long")
    add_robot(parser, domain=True, actions=actions.choices.values())


def run(args: argparse.Namespace) -> int:
    """Look until Ctrl-C, or as long as asked; 1 if nothing came."""
    from runtime.access import gate
    from runtime.bus.zenoh_bus import ZenohBus

    with ZenohBus(gate.visit(args.robot)) as bus:
        return _list(bus, args) if args.action == "list" else _follow(bus, args)


def _list(bus: Any, args: argparse.Namespace) -> int:
    from runtime import messages

    endpoints = messages.endpoints_of(bus.tokens(f"@ros2_lv/{args.domain}/**"))
    for name in sorted({endpoint.topic for endpoint in endpoints}):
        those = [endpoint for endpoint in endpoints if endpoint.topic == name]
        publishers = ", ".join(sorted({e.node for e in those if e.kind == "MP"})) or "nobody"
        readers = ", ".join(sorted({e.node for e in those if e.kind == "MS"})) or "nobody"
        print(fitted(f"{name:28} {those[0].type:44} {publishers} -> {readers}", 4))
    return 0 if endpoints else 1


def _found(bus: Any, args: argparse.Namespace) -> "messages.Endpoint":
    """Return the topic that was asked for as its publisher declares it; one of ours that nobody has yet, too.

    Raises:
        ConfigError: Neither: there is no such topic.
    """
    from runtime import messages
    from runtime.topics import topic

    name = args.topic.strip("/")
    names = (f"{args.robot}/{name}", name)
    endpoints = messages.endpoints_of(bus.tokens(f"@ros2_lv/{args.domain}/**"))
    there = [endpoint for full in names for endpoint in endpoints if endpoint.topic == full]
    if there:
        return next((endpoint for endpoint in there if endpoint.kind == "MP"), there[0])
    row = topic(name.removeprefix(f"{args.robot}/"))
    hashed = messages.type_hash(row.type)
    return messages.Endpoint("MP", "", f"{args.robot}/{row.name}", row.type, hashed, row.latched)


def _follow(bus: Any, args: argparse.Namespace) -> int:
    from runtime import messages
    from runtime.bus.inbox import Inbox
    from runtime.bus.offset import measured
    from runtime.cli.message_text import LONG, text_of
    from runtime.clock import Clock
    from runtime.latency import Histogram
    from runtime.topics import ALL, Topic

    found = _found(bus, args)
    if args.action != "hz" and not messages.is_known(found.type, found.hash):
        raise ConfigError(f"{found.topic}: {found.type} {found.hash} is not known here; only hz works")
    if args.action == "delay" and not messages.has_header(found.type):
        raise ConfigError(f"{found.topic}: {found.type} has no header, and so no stamp")
    clock = Clock()
    row = Topic(found.topic, found.type, 0.0)
    inbox = Inbox(row, clock, lambda: False, keep=ALL, raw=args.action != "echo")
    bus.subscribe(found.key(args.domain), inbox.mailbox.put, latched=found.latched)
    longest = sys.maxsize if args.action == "echo" and args.full else LONG
    offset = measured(bus, args.robot, clock) if args.action == "delay" else None
    if offset is not None:
        print(f"clock of {args.robot}: {offset}", flush=True)
    began = said = time.monotonic()
    seen, delays = 0, Histogram()
    first_s = last_s = 0.0
    while (not args.count or seen < args.count) and (
        not args.within or time.monotonic() - began < args.within
    ):
        received = inbox.wait(0.25)
        if received is not None:
            seen += 1
            last_s = received.received_ns / 1e9
            first_s = first_s or last_s
            if args.action == "echo":
                print(f"{text_of(received.message, longest)}\n---", flush=True)
            elif (stamp_ns := messages.peek_stamp_ns(received.payload)) is not None:
                now_ns = received.received_ns + (offset.offset_ns if offset else 0)
                delays.add((now_ns - stamp_ns) / 1e6)
        if args.action != "echo" and time.monotonic() - said > 1.0:
            said = time.monotonic()
            _measured(args.action, seen, last_s - first_s, delays, inbox.missed)
    if args.action != "echo":
        _measured(args.action, seen, last_s - first_s, delays, inbox.missed)
    elif inbox.missed or inbox.undecodable:
        print(f"{inbox.missed} missed, {inbox.undecodable} undecodable", file=sys.stderr)
    return 0 if seen else 1


def _measured(action: str, seen: int, span_s: float, delays: Any, missed: int) -> None:
    lost = f", {missed} missed" if missed else ""
    if action == "hz":
        rate = f"{(seen - 1) / span_s:.2f} Hz" if span_s > 0 else "no rate yet"
        print(f"{rate}, {seen} messages{lost}", flush=True)
    elif delays.count:
        p50, p99, worst = delays.summary().values()
        print(f"p50 {p50:.1f} ms, p99 {p99:.1f} ms, max {worst:.1f} ms, {seen} messages{lost}", flush=True)
