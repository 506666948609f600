"""Check a map, simplify it, show where it lets a robot know its place.

Rules: reads options and prints; findings are worlds.validate's, fewer walls worlds.simplify's, the bound weakness's.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from localization.cli.options import check_writable, noise, positive
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
from worlds.simplify import apart_in, simplified
from worlds.validate import Finding, Limits, Space, findings, space
from worlds.world import World

MOST_SHOWN_IN = 3.0
"""Beyond this all is equally bad."""


def draw_map(path: Path, world: World, found: Space, worst_in: Floats, findings: Sequence[Finding]) -> None:
    """A PNG file. `worst_in` (k,): of the places of `found` that are reached, row by row."""
    picture = blank(8.0, 7.0)
    axes = picture.subplots()
    axes.set_aspect("equal")
    over = np.full(found.reached.shape, np.nan)
    over[found.reached] = worst_in
    top = min(MOST_SHOWN_IN, float(np.nanmax(over, initial=0.01)))
    least = min(float(np.nanmin(over, initial=top)), 0.9 * top)
    colours = axes.pcolormesh(found.xs, found.ys, over.T, shading="nearest", cmap="viridis_r", vmin=least, vmax=top)
    bar = picture.colorbar(colours, ax=axes, extend="max", shrink=0.85)
    bar.set_label("bound on the position's std, worst direction (in)")
    draw_walls(axes, world.walls)
    starts = np.array([(start.x_in, start.y_in) for start in world.starts])
    axes.plot(*starts.T, marker="o", color=GOAL, linestyle="", label="starts")
    if findings:
        places = np.array([finding.place_in for finding in findings])
        axes.plot(*places.T, marker="x", color=ESTIMATE, markersize=9, linestyle="", label="findings")
    axes.set(xlabel="x (in)", ylabel="y (in)", title=world.title or world.name)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=2, frameon=False)
    save(picture, path)


CELL_IN = 3.0
WEAK_IN = 1.0
FOUND = ExitCode.NOT_REACHED


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of `nomad map`."""
    parser.description = "Look at a map: what is wrong with its walls, how to have fewer, where localization is weak."
    parser.epilog = "example: nomad map show several_walls --out out/map.png"
    tools = parser.add_subparsers(dest="tool", required=True, metavar="check|simplify|show")
    check = tools.add_parser("check", help="gaps, doubled walls, crumbs, starts without room, space that is closed off")
    check.add_argument(
        "--gap",
        type=positive,
        default=Limits().gap_in,
        metavar="IN",
        help="ends of walls this near to another wall are gaps (default %(default)s in)",
    )
    simplify = tools.add_parser("simplify", help="the same map with fewer walls, within a tolerance")
    simplify.add_argument(
        "--tolerance", type=positive, default=0.5, metavar="IN", help="no wall moves farther (default %(default)s in)"
    )
    simplify.add_argument("--out", type=Path, required=True, metavar="FILE", help="the world file to write")
    show = tools.add_parser("show", help="how well a robot can know its place: the Cramer-Rao bound over free space")
    show.add_argument("--out", type=Path, metavar="PNG", help="draw it (needs the extra `plot`)")
    show.add_argument(
        "--sonars",
        choices=("rays", "cones"),
        default="cones",
        help="exact rays or a real ring's cones (default %(default)s)",
    )
    show.add_argument(
        "--cell",
        type=positive,
        default=CELL_IN,
        metavar="IN",
        help="a place every so many inches (default %(default)s)",
    )
    show.add_argument("--speed", type=positive, default=5.0, metavar="IN_S", help="of the robot (default %(default)s)")
    show.add_argument(
        "--odometry-noise",
        type=noise,
        default=THESIS_ODOMETRY,
        metavar="A,B,C",
        help="stds of what the encoders miss: in after 1 in, rad after 1 rad, rad after 1 in",
    )
    show.add_argument(
        "--weak",
        type=positive,
        default=WEAK_IN,
        metavar="IN",
        help="places where the bound is above this are weak (default %(default)s in)",
    )
    for tool in (check, simplify, show):
        tool.add_argument("world", metavar="WORLD", help="a shipped world or a TOML file")
        if tool is not simplify:
            tool.add_argument("--body", choices=sorted(BODIES), default="n150", help="the robot (default n150)")
        tool.add_argument("--json", action="store_true", help="print the result as JSON, alone on stdout")


def run(options: argparse.Namespace) -> int:
    """Do it. `check` gives 3 where it found something."""
    world = load_world(options.world)
    if options.tool == "simplify":
        return _simplify(world, options)
    return _check(world, options) if options.tool == "check" else _show(world, options)


def _check(world: World, options: argparse.Namespace) -> int:
    found = findings(world, BODIES[options.body].radius_in, Limits(gap_in=options.gap))
    if options.json:
        print(json.dumps([finding._asdict() for finding in found]))
    else:
        print("\n".join(_line(finding) for finding in found) or f"{world.name}: {len(world.walls)} walls, all well")
    return FOUND if found else 0


def _line(finding: Finding) -> str:
    x, y = finding.place_in
    return f"{finding.kind:10}  ({x:7.1f}, {y:7.1f})  {finding.words}"


def _simplify(world: World, options: argparse.Namespace) -> int:
    check_writable(options.out)
    simpler = simplified(world, options.tolerance)
    far_in = apart_in(world.walls, simpler.walls)
    said = f"nomad map simplify {world.name} --tolerance {options.tolerance:g}: {far_in:.3g} in apart at most"
    text = format_world(simpler, said)
    parse_world(text, str(options.out), world.name)
    try:
        options.out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise WorldFileError(describe_write_error(options.out, error)) from error
    told = {"walls_before": len(world.walls), "walls": len(simpler.walls), "apart_in": far_in}
    print(
        json.dumps(told)
        if options.json
        else f"{told['walls_before']} walls became {told['walls']}, {far_in:.3g} in apart at most: {options.out}"
    )
    return 0


def _show(world: World, options: argparse.Namespace) -> int:
    if options.out is not None:
        from localization.live.plot import check_picture

        check_picture(options.out)
    body = BODIES[options.body]
    reached = space(world, body.radius_in, options.cell)
    columns, rows = np.nonzero(reached.reached)
    places = np.stack((reached.xs[columns], reached.ys[rows]), axis=-1)
    if not len(places):
        raise WorldFileError(
            f"{world.name}: a {options.body} fits at none of its starts: nomad map check {options.world}"
        )
    sonar = WIRE_SONAR if options.sonars == "rays" else ConeSonar()
    bound = compute_observability(
        LocalizationConfig(world.walls, body, options.odometry_noise, sonar), places, options.speed
    )
    numbers = _numbers(bound, reached, options.weak)
    if options.out is not None:
        draw_map(options.out, world, reached, bound.worst_in, findings(world, body.radius_in))
    print(json.dumps(numbers) if options.json else _words(world, numbers, options))
    return 0


def _numbers(bound: Observability, reached: Space, weak_in: float) -> dict[str, Any]:
    worst, heading = bound.worst_in, np.degrees(bound.heading_rad)
    at = int(worst.argmax())
    return {
        "places": len(worst),
        "cell_in": reached.step_in,
        "best_in": float(worst.min()),
        "median_in": float(np.median(worst)),
        "worst_in": float(worst[at]),
        "worst_at_in": bound.places[at].tolist(),
        "worst_direction_deg": _direction_deg(bound.cov[at]),
        "median_heading_deg": float(np.median(heading)),
        "worst_heading_deg": float(heading.max()),
        "weak_share": float((worst > weak_in).mean()),
    }


def _direction_deg(cov: Floats) -> float:
    """Along which the position is known worst, 0 to 180."""
    along = np.linalg.eigh(cov[:2, :2])[1][:, -1]
    return math.degrees(math.atan2(along[1], along[0])) % 180.0


def _words(world: World, numbers: dict[str, Any], options: argparse.Namespace) -> str:
    x, y = numbers["worst_at_in"]
    return (
        f"{world.name}, {options.sonars}, {options.speed:g} in/s: the least std, of {numbers['places']} places\n"
        f"position   best {numbers['best_in']:.2f}, median {numbers['median_in']:.2f}, worst {numbers['worst_in']:.2f} "
        f"in at ({x:.0f}, {y:.0f}), along {numbers['worst_direction_deg']:.0f} deg\n"
        f"heading    median {numbers['median_heading_deg']:.2f}, worst {numbers['worst_heading_deg']:.2f} deg\n"
        f"weak       {numbers['weak_share']:.1%} of the free space is above {options.weak:g} in"
    )
