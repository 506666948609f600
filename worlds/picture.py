"""A world as an SVG picture: what a notebook shows of a `World`, and the gallery of docs/worlds.md.

y points up as in the world; lengths in the picture are inches, stroke widths pixels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from html import escape
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from worlds.world import Point, World

MARGIN: Final = 0.06
"""Border around the walls, as a fraction of the larger side."""
SCALE_BARS_M: Final = (0.5, 1, 2, 5, 10, 20)
"""Lengths of the scale bar; the longest one within a third of the width is drawn."""
IN_PER_M: Final = 1.0 / 0.0254
MAX_STARTS: Final = 40
"""Starts that are drawn."""


def world_svg(world: World, width_px: int = 420) -> str:
    """Return the picture of a world: floor, walls, obstacles, starts with their headings, and a scale in metres."""
    # 1. The box around all walls, with a margin and a strip for the scale below.
    ends = world.walls.reshape(-1, 2)
    (x, y), (to_x, to_y) = ends.min(axis=0).tolist(), ends.max(axis=0).tolist()
    larger = max(to_x - x, to_y - y, 1.0)
    border = MARGIN * larger
    width, height = to_x - x + 2 * border, to_y - y + 3 * border
    height_px = round(width_px * height / width)
    # 2. Everything in inches, y up; strokes keep their width in pixels.
    shapes = "".join(_shapes(world, larger))
    line = width / width_px
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_px}" height="{height_px}" role="img" '
        f'viewBox="{x - border:.1f} {-to_y - border:.1f} {width:.1f} {height:.1f}">'
        f"<title>{escape(world.title or world.name)}</title>"
        f'<rect x="{x - border:.1f}" y="{-to_y - border:.1f}" width="{width:.1f}" height="{height:.1f}" fill="#fff"/>'
        f'<g stroke-width="{2 * line:.2f}" stroke-linecap="round" stroke-linejoin="round">{shapes}</g>'
        f"{_scale(x, border - y, to_x - x, border, line)}</svg>\n"
    )


def _shapes(world: World, larger: float) -> Iterator[str]:
    for room in world.rooms:
        yield f'<polygon points="{_points(room.corners_in)}" fill="#f4f6f8" stroke="#52616b"/>'
    for x1, y1, x2, y2 in world.inner_walls.tolist():
        yield f'<path d="M{x1:.1f} {0.0 - y1:.1f}L{x2:.1f} {0.0 - y2:.1f}" stroke="#52616b"/>'
    for obstacle in world.obstacles:
        yield f'<polygon points="{_points(obstacle.corners_in)}" fill="#c8d1d8" stroke="#52616b"/>'
    for door in world.doors:
        dash = ' stroke-dasharray="4 3"' if door.is_open else ""
        yield f'<polyline points="{_points(door.ends_in)}" fill="none" stroke="#b0410e"{dash}/>'
    for walker in world.walkers:
        outline = "polygon" if walker.is_closed else "polyline"
        yield f'<{outline} points="{_points(walker.points_in)}" fill="none" stroke="#8a94a6" stroke-dasharray="1 4"/>'
        x, y = walker.points_in[0]
        yield f'<circle cx="{x:.1f}" cy="{0.0 - y:.1f}" r="{walker.radius_in:.1f}" fill="#8a94a6"/>'
    # A start is a disc with a line along its heading.
    size = min(9.0, 0.04 * larger)
    for start in world.starts[:MAX_STARTS]:
        x, y = start.x_in, 0.0 - start.y_in
        nose_x, nose_y = x + 2 * size * math.cos(start.steering_rad), y - 2 * size * math.sin(start.steering_rad)
        yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size:.1f}" fill="#2e8b57"/>'
        yield f'<path d="M{x:.1f} {y:.1f}L{nose_x:.1f} {nose_y:.1f}" stroke="#2e8b57"/>'


def _points(corners: Sequence[Point]) -> str:
    return " ".join(f"{x:.1f},{0.0 - y:.1f}" for x, y in corners)


def _scale(x: float, y: float, width: float, border: float, line: float) -> str:
    """Return a bar of a round number of metres below the picture."""
    metres = max((bar for bar in SCALE_BARS_M if bar * IN_PER_M <= width / 3), default=SCALE_BARS_M[0])
    return (
        f'<path d="M{x:.1f} {y:.1f}h{metres * IN_PER_M:.1f}" stroke="#1b1b1b" stroke-width="{2 * line:.2f}"/>'
        f'<text x="{x + metres * IN_PER_M + 0.3 * border:.1f}" y="{y + 0.25 * border:.1f}" '
        f'font-size="{0.75 * border:.1f}" font-family="sans-serif" fill="#1b1b1b">{metres:g} m</text>'
    )
