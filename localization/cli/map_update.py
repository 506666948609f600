"""`nomad map update`: compare a map with a drive, recorded or live, and propose what has changed."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from localization.cli import arguments, map_learn
from localization.filters.belief import Floats
from localization.mapping.output import MapRefused
from localization.mapping.survey import RobotMoved
from localization.mapping.update import MapDifference, compare, start_pose
from localization.plot import check_picture
from nclient.common.files import write_errors_as
from nclient.common.process import ExitCode, show_seconds
from nclient.errors import OutputFileError
from worlds.io import format_world, load_world, parse_world
from worlds.world import World


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad map update`."""
    parser.description = (
        "Compare a map with a drive and propose what has changed: walls that moved, are missing or new, and an error "
        "of scale. The robot drives as for nomad map learn, or a recorded drive is read (--from). Nothing is written "
        "without --out."
    )
    parser.epilog = "example: nomad map update room.toml --from drive.log --picture changes.png --out newer.toml"
    parser.add_argument("world", metavar="WORLD", help="map: a shipped world or a TOML file")
    parser.add_argument("--start", type=arguments.parse_pose, metavar="X,Y,DEG",
                        help="pose at which the drive begins, in the frame of the map, within 2 in and 5 deg (default: "
                             "the first start of the map)")  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the map with the changes as this world file")
    map_learn.add_drive_arguments(parser)


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code: 0 without changes, 3 with some; 4 if the drive does not fit the map."""
    # 1. Report what is wrong before the work.
    arguments.check_writable(options.out)
    if options.picture is not None:
        check_picture(options.picture)
    world = load_world(options.world)
    try:
        # 2. The walls of the drive.
        with map_learn.page_of(options) as page:
            recordings, _ = map_learn.recordings_of(options, options.out or Path("update.toml"), page)
        learner = map_learn.learner_of(options, map_learn.read_source(options, recordings))
        with show_seconds("learning the walls of the drive"):
            while not learner.is_complete:
                learner.advance()
            learner.finish()
        # 3. The differences.
        start = start_pose(world, options.start)
        found = compare(world, learner.estimate, start, learner.rest, learner.turret_rad)
    except (MapRefused, RobotMoved) as error:
        print(f"nomad map update: no comparison: {error}", file=sys.stderr)
        return ExitCode.UNFIT
    if options.picture is not None:
        _draw(options.picture, world, found)
    if options.out is not None:
        _write(options.out, found.world, f"nomad map update {options.world}: {len(found.changes)} changes")
    print(json.dumps(found.as_json()) if options.json else "\n".join(found.lines()))
    return ExitCode.DONE if found.is_empty else ExitCode.NOT_REACHED


def _write(path: Path, world: World, comment: str) -> None:
    """Write a world file. Reading it again checks it as any other."""
    text = format_world(world, comment)
    parse_world(text, str(path), world.name)
    with write_errors_as(OutputFileError, path):
        path.write_text(text, encoding="utf-8")


def _draw(path: Path, world: World, found: MapDifference) -> None:
    """Draw the map, what is no longer there, and what has been found in its place."""
    from localization.plot import save
    from worlds.drawing import ESTIMATE, GOAL, ODOMETRY, blank, draw_walls

    picture = blank(9.0, 8.0)
    axes = picture.subplots()
    axes.set_aspect("equal")
    draw_walls(axes, world.walls * found.scale)
    for color, style, label, walls in (
        (ESTIMATE, "--", "no longer there", [change.before for change in found.changes]),
        (GOAL, "-", "found", [change.after for change in found.changes]),
    ):
        shown = [_by_columns(wall) for wall in walls if wall is not None]
        for number, columns in enumerate(shown):
            axes.plot(*columns, color=color, linestyle=style, linewidth=2.5, label="" if number else label)
    axes.plot(*found.pose[:2], marker="o", color=ODOMETRY, linestyle="", label="robot now")
    axes.set(xlabel="x (in)", ylabel="y (in)", title="\n".join(found.lines()[-1:]))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)
    save(picture, path)


def _by_columns(wall: Floats) -> Floats:
    """Return x and y (2, 2) of the ends of a wall (4,)."""
    columns: Floats = np.reshape(wall, (2, 2)).T
    return columns
