"""Paint on a saved map: erase, draw walls, keep robots out.

The session keeps the paint as a layer, over what the laser sees.
"""

import argparse
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from runtime.cli.for_machines import print_json
from runtime.errors import ConfigError

if TYPE_CHECKING:
    from processing.dpslam.layer import Layer
    from runtime.nodes.saved import Saved

KINDS = ("erased", "wall", "keep_out", "all")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; heavy imports wait until `run`."""
    parser.add_argument("session", type=Path, help="session file, or a results folder that holds one")
    parser.add_argument(
        "edited",
        type=Path,
        nargs="?",
        help="map.pgm after painting, PGM or PNG: white erases, black is wall, a colour keeps out",
    )
    parser.add_argument(
        "--keepout", type=Path, metavar="MASK", help="what is black in it, and nothing else, is kept out"
    )
    parser.add_argument("--clear", choices=KINDS, action="append", default=[], help="take this off first")
    parser.add_argument("--out", type=Path, metavar="DIR", help="another folder (default: the session's own)")
    parser.add_argument("--json", action="store_true", help="machine-readable, one object")


def run(args: argparse.Namespace) -> int:
    """Store the layer and write the map products anew; 0 done, 2 nothing was painted."""
    from processing.dpslam.layer import Paint
    from runtime.nodes import saved as sessions
    from runtime.nodes.painting import read_edited, read_mask

    saved = sessions.load(args.session)
    path = saved.past.map_t_laser
    layer, left_alone = saved.layer, 0
    if not (args.edited or args.keepout or args.clear):
        raise ConfigError("nothing to do: give an edited picture, --keepout or --clear")
    cleared = {"erased": Paint.ERASED, "wall": Paint.WALL, "keep_out": Paint.KEEP_OUT}
    for kind in args.clear:
        layer = layer.without(*(Paint if kind == "all" else (cleared[kind],)))
    if args.edited:
        painted = read_edited(args.edited, saved.session.parts)
        if not any(len(cells) for cells in painted.cells.values()) and not (args.keepout or args.clear):
            raise ConfigError(f"{args.edited}: differs nowhere from the map of {saved.session.path}")
        layer, left_alone = painted.on(layer, path), painted.left_alone
    if args.keepout:
        mask = read_mask(args.keepout, saved.session.parts)
        layer = layer.without(Paint.KEEP_OUT).painted(mask, Paint.KEEP_OUT, path)
    folder = args.out or saved.session.path.absolute().parent
    check_results(folder, given=args.out is not None)
    write(folder, saved, layer)
    counts = {paint.name.lower(): layer.count(paint) for paint in Paint}
    if args.json:
        print_json({"out": str(folder), "cells": counts, "left_alone": left_alone})
        return 0
    told = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())
    also = ", keepout.pgm + keepout.yaml" if (folder / "keepout.yaml").is_file() else ""
    print(f"{folder}/: session.mcap, map.pgm + map.yaml, map.png{also}; cells on the layer: {told}")
    if left_alone:
        print(f"hallway layer: {left_alone} pixels of other greys paint nothing", file=sys.stderr)
    return 0


def check_results(folder: Path, given: bool) -> None:
    """Refuse a folder that is none of results, before any work; raises ConfigError."""
    from runtime.reports.results import RUN_FILE, check_free

    if not given and not (folder / RUN_FILE).is_file():
        raise ConfigError(f"{folder}: no results folder, so --out DIR must say where the map is written")
    check_free(folder)


def write(folder: Path, saved: "Saved", layer: "Layer") -> None:
    """Write a session with its map products under a layer, all at once; other results there are kept."""
    from processing.dpslam.redrawing import rebuild
    from runtime.formats.session import FILE, SessionWriter
    from runtime.nodes.saved import grid_map, picture_of
    from runtime.reports.results import RUN_FILE, new_folder, to_json, write_products

    past, session = saved.past, saved.session
    seen = rebuild(past, saved.config.slam.mapping, session.seed).occupancy()
    grid = layer.over(seen, past.map_t_laser)
    keep_out = layer.keep_out(grid, past.map_t_laser)
    with new_folder(folder) as fresh:
        drives = f"{session.drives} drives" if session.drives > 1 else "one drive"
        caption = f"{drives}, with what was painted"
        write_products(fresh, grid_map(grid), past.map_t_laser[:, :2], keep_out, caption)
        writer = SessionWriter(fresh / FILE, session.head)
        writer.copy(session.path)
        writer.finish(
            replace(
                session.parts,
                layer=layer.arrays(),
                picture=picture_of(grid),
                resolution_m=grid.resolution_m,
                origin_m=grid.origin_m,
            )
        )
        _keep_others(folder, fresh)
        if not (fresh / RUN_FILE).exists():
            (fresh / "config.yaml").write_text(session.parts.config, encoding="utf-8")
            (fresh / "trajectory.tum").write_bytes(session.parts.trajectory)
            (fresh / RUN_FILE).write_text(to_json(session.head), encoding="utf-8")


def _keep_others(folder: Path, fresh: Path) -> None:
    """Let what else is in a results folder be in the new one too, as the same files."""
    written = {path.name for path in fresh.iterdir()}
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.name in written or path.name.startswith("keepout."):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.copytree(path, fresh / path.name, copy_function=os.link)
        else:
            os.link(path, fresh / path.name, follow_symlinks=False)
