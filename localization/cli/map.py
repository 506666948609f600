"""Check a map, simplify it, show where localization is inaccurate, learn, edit or exchange one.

    nomad map check room.toml                        gaps, doubled walls, places that look alike
    nomad map show several_walls --out map.png       where localization is inaccurate
    nomad map learn nserver://localhost:7019/1 --out room.toml
    nomad map import lab.yaml --out lab.toml         a map of ROS; also CARMEN, SVG, DXF, bitmaps

`nomad map TOOL --help` shows the options of a tool.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from localization.cli import arguments, map_learn
from localization.filters.base import LocalizationConfig
from localization.filters.belief import Floats
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR
from localization.mapping.adjust import TAPE_STD_IN, Adjustment, TapeLength, adjust_walls, label_walls
from localization.mapping.aliases import Alias, AliasFinder, find_aliases
from localization.mapping.observability import Observability, compute_observability
from localization.mapping.output import MapRefused
from localization.mapping.survey import RobotMoved
from localization.mapping.update import MapDifference, compare, start_pose
from localization.plot import check_picture, save
from nclient.common.arguments import add_flag, add_value
from nclient.common.files import write_errors_as
from nclient.common.process import ExitCode, show_seconds
from nclient.errors import MapFileError, WorldFileError
from worlds.cells import hausdorff_distance_in, simplify_world
from worlds.drawing import ESTIMATE, GOAL, ODOMETRY, blank, draw_walls
from worlds.io import load_world
from worlds.map_files import IN_PER_M, ImportSettings, read_map_file, write_ros_map
from worlds.robots import BODIES
from worlds.validate import Finding, FreeSpace, ValidationLimits, find_free_space, validate_world
from worlds.world import Point, World

# `nomad map edit`: adjust a learned map to lengths that were measured with a tape, and name its walls.

def add_edit_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad map edit`."""
    parser.description = (
        "Adjust a learned map to lengths that were measured with a tape: its walls move by least squares, each "
        "according to its standard deviation in the file. Name walls."
    )
    parser.set_defaults(refuse=parser.error)
    parser.epilog = "example: nomad map edit room.toml --length 0,0 114.2,0 114.6 --out better.toml"
    parser.add_argument("world", metavar="WORLD", help="map: a world file of nomad map learn")
    parser.add_argument(
        "--length", action="append", nargs=3, default=[], metavar=("X,Y", "X,Y", "IN"), dest="lengths",
        help="the distance of two ends of walls, given by points near them, in in; repeatable; give "
             "all lengths of a map at once, so that each counts once",
    )  # fmt: skip
    parser.add_argument(
        "--label", action="append", nargs=2, default=[], metavar=("X,Y", "NAME"), dest="labels",
        help="the name of the wall nearest to a point, within 6 in; an empty one removes it; repeatable",
    )  # fmt: skip
    add_value(parser, "--tape-std", "IN", arguments.parse_positive,
              "standard deviation of the measured lengths in inches", TAPE_STD_IN)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="write this world file")
    add_flag(parser, "--json", "print only the result, as JSON, on stdout")


def run_edit(options: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    # 1. Report wrong lengths and an unwritable file before the work.
    tapes = [_tape_length(words, options) for words in options.lengths]
    labels = [_label(words, options) for words in options.labels]
    if not tapes and not labels:
        options.refuse("nothing to change: give --length or --label")
    arguments.check_writable(options.out)
    world = load_world(options.world)
    named = label_walls(world, labels)
    found = adjust_walls(named, tapes) if tapes else Adjustment(named, 0.0, ())
    # 2. Results.
    changes = [f"{tape.length_in:g} in" for tape in tapes] + [f"label {name!r}" for _, name in labels]
    comment = f"nomad map edit {Path(options.world).name}: {', '.join(changes)}"
    arguments.write_world(options.out, found.world, comment)
    result = {"moved_in": found.moved_in, "residuals_in": list(found.residuals_in)}
    print(json.dumps(result) if options.json else _summary(found, tapes, options.out))
    return 0


def _label(words: list[str], options: argparse.Namespace) -> tuple[Point, str]:
    try:
        return arguments.parse_point(words[0]), words[1].strip()
    except (ValueError, argparse.ArgumentTypeError) as error:
        options.refuse(f"--label {' '.join(words)}: {error}")
        raise


def _tape_length(words: list[str], options: argparse.Namespace) -> TapeLength:
    first, second, length = words
    try:
        ends = arguments.parse_point(first), arguments.parse_point(second)
        return TapeLength(ends, arguments.parse_positive(length), options.tape_std)
    except (ValueError, argparse.ArgumentTypeError) as error:
        options.refuse(f"--length {' '.join(words)}: {error}")
        raise


def _summary(found: Adjustment, tapes: list[TapeLength], out: Path) -> str:
    lines = [
        f"{tape.length_in:g} in: {tape.length_in + residual:.2f} in the map now"
        for tape, residual in zip(tapes, found.residuals_in, strict=True)
    ]
    moved = f"ends moved by at most {found.moved_in:.2f} in: {out}" if tapes else str(out)
    return "\n".join([*lines, moved])


ALIKE = "look alike"
MAX_SHOWN_IN = 3.0
"""Upper end of the color scale."""


def draw_map(
    path: Path,
    world: World,
    found: FreeSpace,
    worst_in: Floats,
    findings: Sequence[Finding],
    aliases: Sequence[Alias] = (),
) -> None:
    """Draw a map as PNG, colored by the bound.

    Parameters
    ----------
    path : Path
    world : World
    found : FreeSpace
    worst_in : (k,) array
        Bound at the reachable positions of `found`, row by row.
    findings : sequence of Finding
    aliases : sequence of Alias
        Places that look alike are joined by lines.
    """
    picture = blank(8.0, 7.0)
    axes = picture.subplots()
    axes.set_aspect("equal")
    over = np.full(found.reached.shape, np.nan)
    over[found.reached] = worst_in
    top = min(MAX_SHOWN_IN, float(np.nanmax(over, initial=0.01)))
    least = min(float(np.nanmin(over, initial=top)), 0.9 * top)
    colours = axes.pcolormesh(found.xs, found.ys, over.T, shading="nearest", cmap="viridis_r", vmin=least, vmax=top)
    bar = picture.colorbar(colours, ax=axes, extend="max", shrink=0.85)
    bar.set_label("bound on the position's std, worst direction (in)")
    draw_walls(axes, world.walls)
    for row, name in world.wall_names.items():
        x1, y1, x2, y2 = world.inner_walls[row]
        axes.annotate(name, ((x1 + x2) / 2, (y1 + y2) / 2), xytext=(3, 3), textcoords="offset points", fontsize=8)
    starts = np.array([(start.x_in, start.y_in) for start in world.starts])
    axes.plot(*starts.T, marker="o", color=GOAL, linestyle="", label="starts")
    if findings:
        places = np.array([finding.place_in for finding in findings])
        axes.plot(*places.T, marker="x", color=ESTIMATE, markersize=9, linestyle="", label="findings")
    for alias in aliases:
        for pose in alias.alike:
            label = "" if axes.get_legend_handles_labels()[1][-1:] == [ALIKE] else ALIKE
            axes.plot(*np.array([alias.pose[:2], pose[:2]]).T, color=ESTIMATE, linewidth=0.4, marker=".", label=label)
    axes.set(xlabel="x (in)", ylabel="y (in)", title=world.title or world.name)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=2, frameon=False)
    save(picture, path)


# Default grid step of `show`, inches, and the number of positions above which it is larger: a flat of 12 x 9 m takes
# 2 s of processor time for 1000, and the median changes by 1 % from 2500.
CELL_IN, MAX_PLACES = 3.0, 1000
# Bound above which a position is called weak, inches.
WEAK_IN = 1.0
# Places examined for others that look alike, by `check` and for the picture of `show`; lines and poses printed of them.
ALIAS_SAMPLES, SHOWN_ALIAS_SAMPLES, MAX_NOTES, MAX_ALIKE = 40, 24, 8, 4
# Exit code 3, as of other commands that ran and did not succeed.
PROBLEMS_FOUND = ExitCode.NOT_REACHED


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad map`."""
    tools = parser.add_subparsers(
        dest="tool", required=True, metavar="check|simplify|show|learn|update|edit|import|export"
    )

    def add_tool(name: str, execute: Callable[[argparse.Namespace], int], about: str) -> argparse.ArgumentParser:
        parser = tools.add_parser(name, help=about, description=f"{about[0].upper()}{about[1:]}.")
        parser.set_defaults(execute=execute)
        return parser

    check = add_tool(
        "check", _check,
        "find gaps, doubled walls, very short walls, starts without space, closed-off space; name places that "
        "look alike",
    )  # fmt: skip
    add_value(check, "--gap", "IN", arguments.parse_positive,
              "report ends of walls within this many inches of another wall as gaps", ValidationLimits().gap_in)
    check.add_argument(
        "--at",
        type=arguments.parse_point,
        nargs="+",
        default=[],
        metavar="X,Y",
        help="name the places that look like these positions (default: like the starts and others over the map)",
    )
    simplify = add_tool("simplify", _simplify, "write the map with fewer walls, within a tolerance")
    add_value(simplify, "--tolerance", "IN", arguments.parse_positive, "move walls by at most this many inches", 0.5)
    simplify.add_argument("--out", type=Path, required=True, metavar="FILE", help="write this world file")
    show = add_tool("show", _show, "show the accuracy of localization: the Cramer-Rao bound over free space")
    add_value(show, "--out", "PNG", Path, "draw it into this file (needs the extra `plot`)")
    show.add_argument("--sonars", choices=("rays", "cones"), default="cones",
                      help="sonar model: exact rays, or the cones of a real ring (default: %(default)s)")
    add_value(show, "--cell", "IN", arguments.parse_positive,
              f"grid step in inches (default: {CELL_IN:g}, or larger for about {MAX_PLACES} positions at most)")
    add_value(show, "--speed", "IN_S", arguments.parse_positive, "speed of the robot in inches per second", 5.0)
    arguments.add_odometry_noise(show)
    add_value(show, "--weak", "IN", arguments.parse_positive,
              "call positions with a bound above this many inches weak", WEAK_IN)
    _add_update(
        add_tool("update", _update, "compare a map with a drive: moved, missing and new walls, an error of scale")
    )
    map_learn.add_arguments(
        add_tool("learn", map_learn.run, "make a map of the room by driving, or from a recorded drive")
    )
    add_edit_arguments(add_tool("edit", run_edit, "adjust a learned map to lengths measured with a tape"))
    _add_import(add_tool("import", _import, "make a world file of a ROS, CARMEN, SVG or DXF map, or of a bitmap"))
    _add_export(add_tool("export", _export, "write a world as map of ROS: map.yaml and PGM"))
    for tool in (check, simplify, show):
        tool.add_argument("world", metavar="WORLD", help="map: a shipped world or a TOML file")
        if tool is not simplify:
            tool.add_argument("--body", choices=sorted(BODIES), default="n150", help="robot model (default: n150)")
        add_flag(tool, "--json", "print only the result, as JSON, on stdout")


def _add_update(parser: argparse.ArgumentParser) -> None:
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


def _add_import(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help=".yaml (ROS), .map (CARMEN), .svg, .dxf or a bitmap")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="write this world file")
    add_value(parser, "--tolerance", "IN", arguments.parse_positive,
              "straighten walls within this many inches (default: 0.9 cells; 0.25 in of a drawing's curves)")
    scale = parser.add_mutually_exclusive_group()
    add_value(scale, "--cell", "IN", arguments.parse_positive, "side of a bitmap's pixel in inches")
    add_value(scale, "--unit", "IN", arguments.parse_positive,
              "inches of a drawing's unit (default: as the file states)")
    add_value(parser, "--min-cells", "N", int, "ignore smaller spots of a grid", 4)
    add_flag(parser, "--close", "put walls where known space ends without one")
    parser.add_argument(
        "--layer", action="append", default=[], metavar="NAME", help="read this layer of a DXF; repeatable"
    )
    add_value(parser, "--picture", "PNG", Path, "draw the walls into this file (extra `plot`)")
    add_flag(parser, "--json", "print only the result, as JSON, on stdout")


def _add_export(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("world", metavar="WORLD", help="map: a shipped world or a TOML file")
    parser.add_argument("--out", type=Path, required=True, metavar="YAML", help="write this file, and a PGM beside it")
    add_value(parser, "--resolution", "M", arguments.parse_positive, "side of a cell in m", 0.05)
    add_flag(parser, "--json", "print only the result, as JSON, on stdout")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code; `check` returns 3 if it found problems."""
    code: int = options.execute(options)
    return code


def _update(options: argparse.Namespace) -> int:
    """Compare a map with a drive; return 0 without changes, 3 with some, 4 if the drive does not fit the map."""
    # 1. Report what is wrong before the work.
    arguments.check_writable(options.out)
    check_picture(options.picture)
    world = load_world(options.world)
    try:
        # 2. The walls of the drive.
        with map_learn.page_of(options) as page:
            recordings, _ = map_learn.recordings_of(options, options.out or Path("update.toml"), page)
        source = map_learn.read_source(options, recordings)
        with show_seconds("learning the walls of the drive"):
            learner, _ = map_learn.learn_drive(options, source)
        # 3. The differences.
        start = start_pose(world, options.start)
        found = compare(world, learner.estimate, start, learner.rest, learner.turret_rad)
    except (MapRefused, RobotMoved) as error:
        print(f"nomad map update: no comparison: {error}", file=sys.stderr)
        return ExitCode.UNFIT
    if options.picture is not None:
        _draw_changes(options.picture, world, found)
    if options.out is not None:
        comment = f"nomad map update {options.world}: {len(found.changes)} changes"
        arguments.write_world(options.out, found.world, comment)
    print(json.dumps(found.as_json()) if options.json else "\n".join(found.lines()))
    return ExitCode.DONE if found.is_empty else ExitCode.NOT_REACHED


def _draw_changes(path: Path, world: World, found: MapDifference) -> None:
    """Draw the map, what is no longer there, and what has been found in its place."""
    picture = blank(9.0, 8.0)
    axes = picture.subplots()
    axes.set_aspect("equal")
    draw_walls(axes, world.walls * found.scale)
    for color, style, label, walls in (
        (ESTIMATE, "--", "no longer there", [change.before for change in found.changes]),
        (GOAL, "-", "found", [change.after for change in found.changes]),
    ):
        shown = [wall.reshape(2, 2) for wall in walls if wall is not None]
        for number, ends in enumerate(shown):
            axes.plot(*ends.T, color=color, linestyle=style, linewidth=2.5, label="" if number else label)
    axes.plot(*found.pose[:2], marker="o", color=ODOMETRY, linestyle="", label="robot now")
    axes.set(xlabel="x (in)", ylabel="y (in)", title="\n".join(found.lines()[-1:]))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)
    save(picture, path)


def _import(options: argparse.Namespace) -> int:
    # 1. Report unwritable files before the work.
    arguments.check_writable(options.out)
    check_picture(options.picture)
    settings = ImportSettings(
        options.tolerance, options.cell, options.unit, options.min_cells, options.close, tuple(options.layer)
    )
    with show_seconds(f"reading {options.file.name}"):
        found = read_map_file(options.file, settings)
    # 2. The file states where it came from.
    comment = f"nomad map import {options.file.name}: walls at most {found.apart_in:.3g} in from the original"
    world = arguments.write_world(options.out, found.world, comment)
    if options.picture is not None:
        _draw_walls(options.picture, world)
    # 3. Walls that end where the robot that made the map saw no farther are open.
    result = {"walls": len(world.walls), "apart_in": found.apart_in, "open_in": found.open_in}
    opened = f"; {found.open_in:.0f} in of its border are open (--close)" if found.open_in else ""
    words = f"{len(world.walls)} walls, at most {found.apart_in:.3g} in from {options.file}{opened}: {options.out}"
    print(json.dumps(result) if options.json else words)
    return 0


def _export(options: argparse.Namespace) -> int:
    world = load_world(options.world)
    arguments.check_writable(options.out)
    with write_errors_as(MapFileError, options.out):
        image, grid = write_ros_map(world, options.out, options.resolution * IN_PER_M)
    width, height = grid.cells.shape
    result = {"image": str(image), "width": width, "height": height, "resolution_m": options.resolution}
    print(json.dumps(result) if options.json else f"{width} x {height} cells: {options.out}, {image}")
    return 0


def _draw_walls(path: Path, world: World) -> None:
    picture = blank(10.0, 7.0)
    axes = picture.subplots()
    axes.set_aspect("equal")
    draw_walls(axes, world.walls)
    axes.plot(*np.array([(start.x_in, start.y_in) for start in world.starts]).T, marker="o", color=GOAL, linestyle="")
    axes.set(xlabel="x (in)", ylabel="y (in)", title=world.title or world.name)
    save(picture, path)


def _check(options: argparse.Namespace) -> int:
    world, body = load_world(options.world), BODIES[options.body]
    with show_seconds("checking walls and places that look alike"):
        found = validate_world(world, body.radius_in, ValidationLimits(gap_in=options.gap))
        places, aliases = _find_aliases(world, body.radius_in, options.at)
    notes = [_note(alias) for alias in aliases]
    if options.json:
        listed = [note._asdict() | {"poses": _poses_deg(alias)} for note, alias in zip(notes, aliases, strict=True)]
        print(json.dumps([finding._asdict() for finding in found] + listed))
        return PROBLEMS_FOUND if found else 0
    # Places that look alike are no problem of the map: they are listed, and change no exit code.
    lines = [_line(finding) for finding in found] or [f"{world.name}: {len(world.walls)} walls, no problems"]
    if options.at and not aliases:
        lines.append("no other place looks like the given ones")
    elif aliases:
        lines += [_line(note) for note in notes[: None if options.at else MAX_NOTES]]
        lines.append(f"note: {len(aliases)} of {places} places examined look like others (--at X,Y for one, "
                     "map show --out for a picture)")  # fmt: skip
    print("\n".join(lines))
    return PROBLEMS_FOUND if found else 0


def _thinned(space: FreeSpace, stride: int) -> FreeSpace:
    """Return every `stride`-th row and column of a grid."""
    part = np.s_[::stride, ::stride]
    return FreeSpace(
        space.xs[::stride], space.ys[::stride], stride * space.step_in, space.fits[part], space.reached[part]
    )


def _find_aliases(
    world: World, radius_in: float, at: Sequence[tuple[float, float]] = (), samples: int = ALIAS_SAMPLES
) -> tuple[int, list[Alias]]:
    """Return how many places were examined, the starts and others or those given, and those with aliases."""
    starts = [(start.x_in, start.y_in, start.steering_rad) for start in world.starts]
    finder = AliasFinder(world.walls, radius_in, [start[:2] for start in starts])
    poses = [(x, y, 0.0) for x, y in at] or starts + [(x, y, 0.0) for x, y in finder.samples(samples).tolist()]
    return len(poses), find_aliases(finder, np.array(poses))


def _note(alias: Alias) -> Finding:
    """Return an alias in words, as a finding."""
    poses = _poses_deg(alias)
    shown = poses[1 : 1 + MAX_ALIKE]
    others = ", ".join(f"({x:z.0f}, {y:z.0f}) at {round(heading) % 360} deg" for x, y, heading in shown)
    more = f" and {len(poses) - 1 - MAX_ALIKE} more" if len(poses) - 1 > MAX_ALIKE else ""
    x, y, heading = poses[0]
    return Finding("alike", (x, y), f"at {round(heading) % 360} deg looks like {others}{more}")


def _poses_deg(alias: Alias) -> list[list[float]]:
    """Return the pose and those that look like it: inches, and degrees from 0 to 360."""
    return [
        [round(float(x), 1), round(float(y), 1), round(math.degrees(heading), 1) % 360.0]
        for x, y, heading in (alias.pose, *alias.alike)
    ]


def _line(finding: Finding) -> str:
    x, y = finding.place_in
    return f"{finding.kind:10}  ({x:7.1f}, {y:7.1f})  {finding.words}"


def _simplify(options: argparse.Namespace) -> int:
    world = load_world(options.world)
    # 1. Report an unwritable file before the work.
    arguments.check_writable(options.out)
    with show_seconds("simplifying"):
        simpler = simplify_world(world, options.tolerance)
        far_in = hausdorff_distance_in(world.walls, simpler.walls)
    # 2. The new file states how it was made, and by how much walls have moved.
    comment = f"nomad map simplify {world.name} --tolerance {options.tolerance:g}: at most {far_in:.3g} in apart"
    arguments.write_world(options.out, simpler, comment)
    result = {"walls_before": len(world.walls), "walls": len(simpler.walls), "apart_in": far_in}
    print(
        json.dumps(result)
        if options.json
        else f"{result['walls_before']} walls became {result['walls']}, at most {far_in:.3g} in apart: {options.out}"
    )
    return 0


def _show(options: argparse.Namespace) -> int:
    world, body = load_world(options.world), BODIES[options.body]
    check_picture(options.out)
    # 1. Positions the robot can reach.
    reached = find_free_space(world, body.radius_in, options.cell or CELL_IN)
    if not options.cell and (count := np.count_nonzero(reached.reached)) > MAX_PLACES:
        reached = find_free_space(world, body.radius_in, CELL_IN * math.sqrt(count / MAX_PLACES))
        # Its steps are no longer than the radius: of a large floor only some of the grid.
        if (stride := round(math.sqrt(np.count_nonzero(reached.reached) / MAX_PLACES))) > 1:
            reached = _thinned(reached, stride)
    columns, rows = np.nonzero(reached.reached)
    places = np.stack((reached.xs[columns], reached.ys[rows]), axis=-1)
    if not len(places):
        raise WorldFileError(
            f"{world.name}: a {options.body} fits at none of its starts: nomad map check {options.world}"
        )
    # 2. The bound there.
    sonar = WIRE_SONAR if options.sonars == "rays" else ConeSonar()
    with show_seconds(f"the bound at {len(places)} positions"):
        bound = compute_observability(
            LocalizationConfig(world.walls, body, options.odometry_noise, sonar), places, options.speed
        )
    numbers = _numbers(bound, reached, options.weak)
    if options.out is not None:
        with show_seconds("places that look alike"):
            draw_map(options.out, world, reached, bound.worst_in, validate_world(world, body.radius_in),
                     _find_aliases(world, body.radius_in, samples=SHOWN_ALIAS_SAMPLES)[1])  # fmt: skip
    print(json.dumps(numbers) if options.json else _words(world, numbers, options))
    return 0


def _numbers(bound: Observability, reached: FreeSpace, weak_in: float) -> dict[str, Any]:
    # Standard deviations along the worst direction of each position, inches; headings in degrees.
    worst, heading = bound.worst_in, np.degrees(bound.heading_rad)
    at = int(worst.argmax())
    return {
        "places": len(worst),
        "cell_in": reached.step_in,
        "best_in": float(worst.min()),
        "median_in": float(np.median(worst)),
        "worst_in": float(worst[at]),
        "worst_at_in": bound.positions[at].tolist(),
        "worst_direction_deg": _direction_deg(bound.cov[at]),
        "median_heading_deg": float(np.median(heading)),
        "worst_heading_deg": float(heading.max()),
        "weak_share": float((worst > weak_in).mean()),
    }


def _direction_deg(cov: Floats) -> float:
    """Return the direction of the largest position uncertainty, 0 to 180 degrees."""
    # eigh sorts eigenvalues in ascending order: the last vector is that of the largest. A direction and its opposite
    # are the same, hence modulo 180.
    along = np.linalg.eigh(cov[:2, :2])[1][:, -1]
    return math.degrees(math.atan2(along[1], along[0])) % 180.0


def _words(world: World, numbers: dict[str, Any], options: argparse.Namespace) -> str:
    x, y = numbers["worst_at_in"]
    return (
        f"{world.name}, {options.sonars}, {options.speed:g} in/s: smallest possible standard deviation "
        f"at {numbers['places']} positions\n"
        f"position   best {numbers['best_in']:.2f}, median {numbers['median_in']:.2f}, worst {numbers['worst_in']:.2f} "
        f"in at ({x:.0f}, {y:.0f}), along {numbers['worst_direction_deg']:.0f} deg\n"
        f"heading    median {numbers['median_heading_deg']:.2f}, worst {numbers['worst_heading_deg']:.2f} deg\n"
        f"weak       {numbers['weak_share']:.1%} of the free space is above {options.weak:g} in"
    )
