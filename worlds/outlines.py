"""What a closed outline in a file has to be: around some area, its corners in their order.

Rules: checks corners that were read (tables.py), in the same words for rooms, obstacles and fences; reads nothing.
"""

from __future__ import annotations

from worlds.geometry import area, crossing, lengths, polygon_segments
from worlds.tables import SHORTEST_IN, Point, Table


def require_outline(table: Table, key: str, corners: tuple[Point, ...]) -> None:
    """Refuse corners whose edges cross, or that lie on one line. Raises WorldFileError about the key."""
    edges = polygon_segments(corners)
    if crossed := crossing(edges):
        one, other = crossed
        table.fail(key, f"expected the corners in their order around, found edges {one} and {other} that cross")
    if abs(area(corners)) <= SHORTEST_IN * float(lengths(edges).max()):
        table.fail(key, "expected an outline around some area, found corners on one line")
