"""What one sonar of one robot may hear out of its cone, in plain numbers: what cone does for many poses in arrays.

Most reflectors are far out of the cone; looked through one by one they cost half a microsecond each, and only the few
that are left are worked out. Rules: pure; cone.cone_returns is the same for any number of poses and its witness. What
each number means is told there.
"""

from __future__ import annotations

from math import atan2, cos, exp, hypot, pi, sin
from typing import Final, NamedTuple

from localization.estimation.belief import wrapped
from localization.sonar.cone import (
    FOOT_STD_IN,
    LEAST_ANGLE_STD_RAD,
    LOGISTIC_SLOPE,
    NEVER,
    NEVER_BELOW,
    SHORT_IN,
    ConeModel,
    Ear,
)
from localization.sonar.reflectors import Reflectors
from worlds.first_wall import FirstWall

_SLACK: Final = 1e-9


class Return(NamedTuple):
    """A reflector that may be heard: its number, range, the derivative by the pose, and the chance that it is heard."""

    which: int
    range_in: float
    jacobian: tuple[float, float, float]
    probability: float


class Listener:
    """A model of cones in a map."""

    def __init__(self, around: Reflectors, model: ConeModel) -> None:
        self._model, self._first = model, FirstWall(around.walls).first
        self._walls = list(
            enumerate(zip(*(part.tolist() for part in (around.corners, around.normals, around.lengths)), strict=True))
        )
        losses = [model.square_loss_db if square else model.edge_loss_db for square in around.square.tolist()]
        self._vertices = list(
            enumerate(zip(around.vertices.tolist(), losses, strict=True), start=len(around.walls))
        )

    def hear(self, pose: tuple[float, float, float], heading_std_rad: float, ear: Ear) -> list[Return]:
        """What a sonar may hear from a pose, in the order of the reflectors."""
        model = self._model
        axis = pose[2] + ear.direction_rad
        axis_x, axis_y = cos(axis), sin(axis)
        arm_x, arm_y = ear.ring_in * axis_x, ear.ring_in * axis_y
        x, y = pose[0] + arm_x, pose[1] + arm_y
        half, softness = 0.5 * model.cone_rad, max(heading_std_rad, LEAST_ANGLE_STD_RAD)
        widest = half + NEVER_BELOW * softness
        least_cosine = cos(widest) - _SLACK if widest < pi else -2.0
        heard = []
        for which, range_in, to_x, to_y, on_wall, lost_db in self._within(x, y, axis_x, axis_y, least_cosine):
            off = wrapped(atan2(to_y, to_x) - axis)
            loss_db = model.rim_loss_db * (off / half) ** 2 + model.way_loss_db_in * range_in + lost_db
            loud = _below((model.margin_db - loss_db) / model.margin_std_db)
            chance = on_wall * _below((half - abs(off)) / softness) * loud
            if chance > NEVER and self._first(x, y, to_x, to_y)[0] >= range_in - SHORT_IN:
                heard.append((range_in, which, (-to_x, -to_y, to_x * arm_y - to_y * arm_x), chance))
        silence, found = 1.0, []
        for range_in, which, jacobian, chance in sorted(heard):
            if chance * silence:
                found.append(Return(which, range_in, jacobian, chance * silence))
            silence *= 1.0 - chance
        return sorted(found)

    def _within(
        self, x: float, y: float, axis_x: float, axis_y: float, least_cosine: float
    ) -> list[tuple[int, float, float, float, float, float]]:
        """Of reflectors that may lie in the cone: number, range, direction, chance that a foot is on its wall, loss."""
        far = NEVER_BELOW * FOOT_STD_IN
        found = []
        for which, ((corner_x, corner_y), (normal_x, normal_y), length) in self._walls:
            off_x, off_y = x - corner_x, y - corner_y
            height, foot = off_x * normal_x + off_y * normal_y, off_x * normal_y - off_y * normal_x
            if not -far < foot < length + far:
                continue
            side = 1.0 if height < 0.0 else -1.0
            if side * (normal_x * axis_x + normal_y * axis_y) > least_cosine:
                on_wall = _below(foot / FOOT_STD_IN) * _below((length - foot) / FOOT_STD_IN)
                found.append((which, abs(height), side * normal_x, side * normal_y, on_wall, 0.0))
        for which, ((vertex_x, vertex_y), lost_db) in self._vertices:
            way_x, way_y = vertex_x - x, vertex_y - y
            range_in = hypot(way_x, way_y)
            if way_x * axis_x + way_y * axis_y >= least_cosine * range_in:
                divisor = max(range_in, 1e-9)
                found.append((which, range_in, way_x / divisor, way_y / divisor, 1.0, lost_db))
        return found


def _below(sigmas: float) -> float:
    """cone's logistic curve, of one number."""
    return 1.0 / (1.0 + exp(min(max(-LOGISTIC_SLOPE * sigmas, -300.0), 300.0)))
