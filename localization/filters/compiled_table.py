"""The most probable echoes of a cone from many places, by the formulas of `sonar_cone`, which numba compiles.

`range_table` has the same in arrays. Among the 1,285 walls of an office floor a place takes 7 ms there and 1 ms here.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from math import pi
from typing import Any

import numpy as np

from localization.filters import compiled
from localization.filters.belief import Floats
from localization.filters.compiled import ConeArrays, ConeSonarRow, ListedWalls, row_of
from localization.filters.sonar_cone import REACH_IN, ConeSonar, Reflectors, first_echoes, to_wall
from localization.filters.sonar_ray import wall_rows
from worlds.compiled import VARIABLE, compile_function, is_wanted, make_compilable, mark_path, write_mark
from worlds.rings import SonarMount


def likeliest_echoes(
    places: Any, ring_in: float, heading_std_rad: float, sonar: Any, walls: Any, faces: Any, vertices: Any,
    ranges_in: Any, probabilities: Any,
) -> None:  # fmt: skip
    """Store the most probable first echo at places (n, 2), in directions that divide a turn.

    Parameters
    ----------
    sonar
        `ConeSonarRow`.
    walls
        `WallArrays` that may block the path.
    faces, vertices
        (m, 5) and (v, 3), as of `sonar_cone.ConeModel`.
    ranges_in, probabilities
        (n, directions) arrays for the result; 0 where no echo is.
    """
    mount, directions = SonarMount(0.0, ring_in, 0.0), ranges_in.shape[1]
    listed: Any = ListedWalls(walls.segments, walls.lines, walls.middle, wall_rows(walls))
    all_vertices: Any = [(row[0], row[1], row[2]) for row in vertices]
    for place in range(len(places)):
        x, y = places[place, 0], places[place, 1]
        # 1. The walls that the robot can have in front, and the vertices.
        in_front: Any = [
            (row[0], row[1], row[2], row[3], row[4]) for row in faces if is_in_front(x, y, row, ring_in + REACH_IN)
        ]
        model: Any = ConeArrays(sonar, listed, in_front, all_vertices, walls.segments, 0)
        # 2. The most probable echo in each direction.
        for direction in range(directions):
            heading = direction * (2.0 * pi / directions)
            for echo in first_echoes(x, y, heading, heading_std_rad, mount, model):
                if echo.probability > probabilities[place, direction]:
                    ranges_in[place, direction] = echo.range_in
                    probabilities[place, direction] = echo.probability


def is_in_front(x: float, y: float, row: Any, reach_in: float) -> bool:
    """Return True if the foot of the perpendicular from near (x, y) may lie on a wall, a row of five numbers."""
    _, _, _, foot = to_wall(x, y, row[0], row[1], row[2], row[3])
    return bool(-reach_in < foot < row[4] + reach_in)


def rows_of(around: Reflectors, sonar: ConeSonar) -> tuple[Floats, Floats]:
    """Return `faces` (m, 5) and `vertices` (v, 3) of reflectors."""
    losses = np.where(around.square, sonar.bounce_loss_db, sonar.edge_loss_db)
    faces = np.concatenate((around.corners, around.normals, around.lengths[:, None]), axis=1)
    return faces, np.column_stack((around.vertices, losses))


@cache
def _compile(sources: int) -> Callable[..., None]:
    """Return `likeliest_echoes` compiled, with plain tuples as arguments, or loaded from the cache."""

    def entry(
        places: Any, ring_in: Any, std: Any, sonar: Any, walls: Any, faces: Any, vertices: Any, ranges: Any,
        probabilities: Any,
    ) -> None:  # fmt: skip
        assert sources >= 0
        arrays = compiled.WallArrays(walls, walls, (0.0, 0.0, 0.0))
        likeliest_echoes(
            places, ring_in, std, ConeSonarRow(*sonar), arrays, faces, vertices, ranges, probabilities
        )

    make_compilable([likeliest_echoes, is_in_front])
    run = compile_function(entry)
    run(np.zeros((0, 2)), 0.0, 0.0, _row(ConeSonar()), *(np.zeros((0, width)) for width in (4, 5, 3, 1, 1)))
    write_mark(mark_path(likeliest_echoes.__name__, sources))
    return run


@cache
def _is_used(sources: int, _word: str) -> bool:
    """Return True if compiled code is wanted and possible; decided once for each value of NOMAD_COMPILED."""
    return is_wanted(likeliest_echoes.__name__, sources) and compiled.load()


def _row(sonar: ConeSonar) -> tuple[float, ...]:
    return tuple(row_of(ConeSonarRow, sonar))


def compiled_echoes(
    places: Floats, directions: int, around: Reflectors, ring_in: float, heading_std_rad: float, sonar: ConeSonar
) -> tuple[Floats, Floats] | None:
    """Return ranges and probabilities (n, directions) of the most probable echo at places (n, 2).

    None if compiled code is not to be used.
    """
    sources = compiled.source_checksum(likeliest_echoes)
    if not _is_used(sources, os.environ.get(VARIABLE, "")):
        return None
    run = _compile(sources)
    ranges, probabilities = np.zeros((len(places), directions)), np.zeros((len(places), directions))
    faces, vertices = rows_of(around, sonar)
    run(np.ascontiguousarray(places, dtype=np.float64), ring_in, heading_std_rad, _row(sonar),
        np.ascontiguousarray(around.walls), faces, vertices, ranges, probabilities)  # fmt: skip
    return ranges, probabilities
