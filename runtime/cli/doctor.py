"""Check port, permission, sensor, clocks, machine and bus.

Each line says what was looked at, what was found, what is needed, and what to do about the difference.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.fitting import fitted
from runtime.cli.for_machines import print_json
from runtime.cli.parsing import number, whole_number

if TYPE_CHECKING:
    from runtime.cli.checkup.finding import Finding

_MARKS = {"ok": "ok  ", "warn": "warn", "fail": "FAIL", "missing": "FAIL"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("--port", default="auto", help="of the laser (default: the first URG on USB)")
    parser.add_argument("--baud", type=whole_number(0), default=0, help="rate on RS-232 (default: USB)")
    parser.add_argument(
        "--seconds", type=number(least=0.0), default=5.0, metavar="S", help="watch the laser (default 5)"
    )
    parser.add_argument("--robot", default="robot", metavar="NAME", help="look at this one if it runs")
    parser.add_argument("--json", action="store_true", help="machine-readable, one object")
    parser.add_argument("--udev", action="store_true", help="print the udev rule of the laser, and end")


def run(args: argparse.Namespace) -> int:
    """Print the findings; 0 if it would work, 3 if there is no laser, else 1."""
    from runtime.cli.checkup.finding import exit_code
    from runtime.cli.checkup.port import rule_text

    if args.udev:
        print(rule_text(), end="")
        return 0
    findings = []
    for finding in _look(args):
        findings.append(finding)
        if not args.json:
            _print(finding)
    code = exit_code(findings)
    if args.json:
        print_json({"works": code == 0, "findings": [finding.as_dict() for finding in findings]})
    else:
        print({0: "it would work", 3: "there is no laser"}.get(code, "it would not work"))
    return code


def _look(args: argparse.Namespace) -> "Iterator[Finding]":
    from runtime.cli.checkup import host, port, sensor
    from runtime.cli.checkup.finding import Finding, Verdict

    path, found = port.find_port(args.port)
    yield found
    if path:
        allowed, held = port.permission(path), port.holder(path)
        yield from (allowed, held)
    yield port.modem_manager()
    if path and Verdict.FAIL not in (allowed.verdict, held.verdict):
        from drivers.urg04lx.settings import UrgConfig

        try:
            config = UrgConfig(port=path, baud=args.baud)
        except ValueError as error:
            rule, _, advice = str(error).partition(";")
            needed = "a line that carries every scan"
            yield Finding(
                what="bandwidth", found=rule, needed=needed, verdict=Verdict.FAIL, advice=advice.strip()
            )
        else:
            if not args.json and sys.stderr.isatty():
                print(f"      watching the laser for {args.seconds:g} s", file=sys.stderr)
            yield from sensor.findings(sensor.watch(config, args.seconds), config)
    yield host.cores()
    yield host.governor()
    yield host.disk(Path("results"))
    yield host.bus()
    if running := host.robot(args.robot):
        yield running


def _print(finding: "Finding") -> None:
    line = f"{_MARKS[finding.verdict.value]}  {finding.what:13} {finding.found}   (needed: {finding.needed})"
    print(fitted(line, 20))
    if finding.advice:  # has commands in it, which must stay whole for who copies them
        print(f"      -> {finding.advice}")
