"""A zenoh router with the configuration that it is given, as `rmw_zenohd` is; until its stdin closes."""

import sys

import zenoh

with zenoh.open(zenoh.Config.from_file(sys.argv[1])):
    print("up", flush=True)
    sys.stdin.read()
