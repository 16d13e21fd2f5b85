"""Look at the topics of a running robot: list them, print messages, measure rate and delay."""

import argparse
import time
from typing import Any


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("--robot", default="robot", metavar="NAME", help="which robot (default robot)")
    parser.add_argument("--domain", type=int, default=0, help="ROS domain (default 0)")
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    actions.add_parser("list", help="names, types, and who publishes and reads them")
    for name, text in (
        ("echo", "print the messages of a topic"),
        ("hz", "measure the rate of a topic"),
        ("delay", "measure the time from a message's stamp to its arrival"),
    ):
        action = actions.add_parser(name, help=text, description=text)
        action.add_argument("topic")
        action.add_argument("-n", "--count", type=int, default=0, help="end after so many messages")
        action.add_argument("--within", type=float, default=0.0, metavar="S", help="end after S seconds")


def run(args: argparse.Namespace) -> int:
    """Look until Ctrl-C, or as long as asked; 1 if nothing came."""
    from runtime import gate
    from runtime.bus_zenoh import ZenohBus

    with ZenohBus(gate.visit(args.robot)) as bus:
        return _list(bus, args) if args.action == "list" else _follow(bus, args)


def _list(bus: Any, args: argparse.Namespace) -> int:
    from runtime import messages

    endpoints = messages.endpoints_of(bus.tokens(f"@ros2_lv/{args.domain}/**"))
    for name in sorted({endpoint.topic for endpoint in endpoints}):
        those = [endpoint for endpoint in endpoints if endpoint.topic == name]
        publishers = ", ".join(sorted({e.node for e in those if e.kind == "MP"})) or "nobody"
        readers = ", ".join(sorted({e.node for e in those if e.kind == "MS"})) or "nobody"
        print(f"{name:28} {those[0].type:44} {publishers} -> {readers}")
    return 0 if endpoints else 1


def _follow(bus: Any, args: argparse.Namespace) -> int:
    from runtime import messages
    from runtime.clock import Clock
    from runtime.inbox import Inbox
    from runtime.latency import Histogram
    from runtime.offset import measured
    from runtime.topics import ALL, topic

    row = topic(args.topic.strip("/").removeprefix(f"{args.robot}/"))
    clock = Clock()
    inbox = Inbox(row, clock, lambda: False, keep=ALL, raw=args.action != "echo")
    key = messages.topic_key(f"{args.robot}/{row.name}", row.type, args.domain)
    bus.subscribe(key, inbox.mailbox.put, latched=row.latched)
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
                print(f"{received.message}\n---", flush=True)
            elif (stamp_ns := messages.peek_stamp_ns(received.payload)) is not None:
                now_ns = received.received_ns + (offset.offset_ns if offset else 0)
                delays.add((now_ns - stamp_ns) / 1e6)
        if args.action != "echo" and time.monotonic() - said > 1.0:
            said = time.monotonic()
            _measured(args.action, seen, last_s - first_s, delays, inbox.missed)
    if args.action != "echo":
        _measured(args.action, seen, last_s - first_s, delays, inbox.missed)
    return 0 if seen else 1


def _measured(action: str, seen: int, span_s: float, delays: Any, missed: int) -> None:
    lost = f", {missed} missed" if missed else ""
    if action == "hz":
        rate = f"{(seen - 1) / span_s:.2f} Hz" if span_s > 0 else "no rate yet"
        print(f"{rate}, {seen} messages{lost}", flush=True)
    elif delays.count:
        p50, p99, worst = delays.summary().values()
        print(f"p50 {p50:.1f} ms, p99 {p99:.1f} ms, max {worst:.1f} ms, {seen} messages{lost}", flush=True)
