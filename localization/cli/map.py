"""Check a map, simplify it, or show where localization is inaccurate."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from localization.cli.options import check_writable, parse_odometry_noise, parse_positive
from localization.filters.base import THESIS_ODOMETRY, LocalizationConfig
from localization.filters.belief import Floats
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR
from localization.live.plot import ESTIMATE, GOAL, blank, draw_walls, save
from localization.mapping.observability import Observability, compute_observability
from nclient.common.exit_codes import ExitCode
from nclient.common.files import describe_write_error
from nclient.errors import WorldFileError
from worlds.io import format_world, load_world, parse_world
from worlds.robots import BODIES
from worlds.simplify import hausdorff_distance_in, simplify_world
from worlds.validate import Finding, FreeSpace, ValidationLimits, find_free_space, validate_world
from worlds.world import World

MAX_SHOWN_IN = 3.0
"""Upper end of the color scale."""


def draw_map(path: Path, world: World, found: FreeSpace, worst_in: Floats, validate_world: Sequence[Finding]) -> None:
    """Draw a map as PNG, colored by the bound.

    Parameters
    ----------
    path : Path
    world : World
    found : FreeSpace
    worst_in : (k,) array
        Bound at the reachable positions of `found`, row by row.
    findings : sequence of Finding
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
    starts = np.array([(start.x_in, start.y_in) for start in world.starts])
    axes.plot(*starts.T, marker="o", color=GOAL, linestyle="", label="starts")
    if validate_world:
        places = np.array([finding.place_in for finding in validate_world])
        axes.plot(*places.T, marker="x", color=ESTIMATE, markersize=9, linestyle="", label="findings")
    axes.set(xlabel="x (in)", ylabel="y (in)", title=world.title or world.name)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=2, frameon=False)
    save(picture, path)


# Default grid step of `show`, inches.
CELL_IN = 3.0
# Bound above which a position is called weak, inches.
WEAK_IN = 1.0
# Exit code 3, as of other commands that ran and did not succeed.
PROBLEMS_FOUND = ExitCode.NOT_REACHED


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad map`."""
    parser.description = "Check a map, simplify it, or show where localization is inaccurate."
    parser.epilog = "example: nomad map show several_walls --out out/map.png"
    tools = parser.add_subparsers(dest="tool", required=True, metavar="check|simplify|show")
    check = tools.add_parser(
        "check", help="find gaps, doubled walls, very short walls, starts without space, closed-off space"
    )
    check.add_argument(
        "--gap",
        type=parse_positive,
        default=ValidationLimits().gap_in,
        metavar="IN",
        help="report ends of walls within this distance in in of another wall as gaps (default: %(default)s)",
    )
    simplify = tools.add_parser("simplify", help="write the map with fewer walls, within a tolerance")
    simplify.add_argument(
        "--tolerance",
        type=parse_positive,
        default=0.5,
        metavar="IN",
        help="move walls by at most this distance in in (default: %(default)s)",
    )
    simplify.add_argument("--out", type=Path, required=True, metavar="FILE", help="write this world file")
    show = tools.add_parser("show", help="show the accuracy of localization: the Cramer-Rao bound over free space")
    show.add_argument("--out", type=Path, metavar="PNG", help="draw it into this file (needs the extra `plot`)")
    show.add_argument(
        "--sonars",
        choices=("rays", "cones"),
        default="cones",
        help="sonar model: exact rays, or the cones of a real ring (default: %(default)s)",
    )
    show.add_argument(
        "--cell",
        type=parse_positive,
        default=CELL_IN,
        metavar="IN",
        help="grid step in in (default: %(default)s)",
    )
    show.add_argument(
        "--speed",
        type=parse_positive,
        default=5.0,
        metavar="IN_S",
        help="speed of the robot in in/s (default: %(default)s)",
    )
    show.add_argument(
        "--odometry-noise",
        type=parse_odometry_noise,
        default=THESIS_ODOMETRY,
        metavar="A,B,C",
        help="standard deviations of the random odometry error: in after 1 in, rad after 1 rad, rad after 1 in",
    )
    show.add_argument(
        "--weak",
        type=parse_positive,
        default=WEAK_IN,
        metavar="IN",
        help="call positions with a bound above this distance in in weak (default: %(default)s)",
    )
    for tool in (check, simplify, show):
        tool.add_argument("world", metavar="WORLD", help="map: a shipped world or a TOML file")
        if tool is not simplify:
            tool.add_argument("--body", choices=sorted(BODIES), default="n150", help="robot model (default: n150)")
        tool.add_argument("--json", action="store_true", help="print only the result, as JSON, on stdout")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code; `check` returns 3 if it found problems."""
    world = load_world(options.world)
    if options.tool == "simplify":
        return _simplify(world, options)
    return _check(world, options) if options.tool == "check" else _show(world, options)


def _check(world: World, options: argparse.Namespace) -> int:
    found = validate_world(world, BODIES[options.body].radius_in, ValidationLimits(gap_in=options.gap))
    if options.json:
        print(json.dumps([finding._asdict() for finding in found]))
    else:
        print("\n".join(_line(finding) for finding in found) or f"{world.name}: {len(world.walls)} walls, no problems")
    return PROBLEMS_FOUND if found else 0


def _line(finding: Finding) -> str:
    x, y = finding.place_in
    return f"{finding.kind:10}  ({x:7.1f}, {y:7.1f})  {finding.words}"


def _simplify(world: World, options: argparse.Namespace) -> int:
    # 1. Report an unwritable file before the work.
    check_writable(options.out)
    simpler = simplify_world(world, options.tolerance)
    far_in = hausdorff_distance_in(world.walls, simpler.walls)
    # 2. The new file states how it was made, and by how much walls have moved.
    comment = f"nomad map simplify {world.name} --tolerance {options.tolerance:g}: at most {far_in:.3g} in apart"
    text = format_world(simpler, comment)
    # 3. Reading it again checks that starts and paths are still in free space.
    parse_world(text, str(options.out), world.name)
    try:
        options.out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise WorldFileError(describe_write_error(options.out, error)) from error
    result = {"walls_before": len(world.walls), "walls": len(simpler.walls), "apart_in": far_in}
    print(
        json.dumps(result)
        if options.json
        else f"{result['walls_before']} walls became {result['walls']}, at most {far_in:.3g} in apart: {options.out}"
    )
    return 0


def _show(world: World, options: argparse.Namespace) -> int:
    if options.out is not None:
        from localization.live.plot import check_picture

        check_picture(options.out)
    body = BODIES[options.body]
    # 1. Positions the robot can reach.
    reached = find_free_space(world, body.radius_in, options.cell)
    columns, rows = np.nonzero(reached.reached)
    places = np.stack((reached.xs[columns], reached.ys[rows]), axis=-1)
    if not len(places):
        raise WorldFileError(
            f"{world.name}: a {options.body} fits at none of its starts: nomad map check {options.world}"
        )
    # 2. The bound there.
    sonar = WIRE_SONAR if options.sonars == "rays" else ConeSonar()
    bound = compute_observability(
        LocalizationConfig(world.walls, body, options.odometry_noise, sonar), places, options.speed
    )
    numbers = _numbers(bound, reached, options.weak)
    if options.out is not None:
        draw_map(options.out, world, reached, bound.worst_in, validate_world(world, body.radius_in))
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
