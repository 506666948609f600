"""What a sonar would read: the distance from the ring, along its own direction, to a wall of the map.

Rules: pure functions on arrays; no gate, no gain (see gating, ekf). A wall is a line in normal form,
normal . p = offset; which wall a beam meets is the ray caster's answer, how far it is and how that changes with the
pose is worked out here. A beam is a ray tied to the robot, and its reading starts `standoff` along it (the ring):

    axis  = (x, y) + Rot(theta) axis_in      direction = Rot(theta) direction
    range = (offset - normal . axis) / (normal . direction) - standoff

so a ring, a turned turret, and a beam fired a moment ago from another pose are all the same thing: Beams.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.estimation.belief import HEADING, Floats
from localization.sonar.range_noise import RangeNoise
from worlds.first_wall import FirstWall
from worlds.raycast import cast_rays

Indices = npt.NDArray[np.intp]


class SonarRing(Protocol):
    """The part of a body that the sonars need; `worlds.bodies.Body` has it."""

    @property
    def sonar_ring_radius_in(self) -> float: ...
    @property
    def sonar_angles_rad(self) -> tuple[float, ...]: ...


@dataclass(frozen=True, slots=True)
class Beams:
    """n rays tied to the robot, in the frame of its position and heading (x ahead, y to the left).

    `axes_in` (..., n, 2), the points they radiate from (the robot's axis: zeros, but for beams fired elsewhere); unit
    `directions` (..., n, 2); `standoff_in`, how far along them the sonars sit. Leading dimensions as the poses'.
    `axes_left` and `directions_left` are the same turned by a quarter, kept because every pose needs them.
    """

    axes_in: Floats
    directions: Floats
    standoff_in: float
    axes_left: Floats = field(init=False, repr=False)
    directions_left: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes_left", left_of(self.axes_in))
        object.__setattr__(self, "directions_left", left_of(self.directions))


class Rays(NamedTuple):
    """Beams at a pose, in the frame of the map: `axes_in`, unit `directions`, and `arms_in`, from the robot's position
    to the axes; each (..., n, 2); and the beams' `standoff_in`."""

    axes_in: Floats
    directions: Floats
    arms_in: Floats
    standoff_in: float


class Sight(NamedTuple):
    """Where rays meet lines; NaN where they run beside the line.

    `ranges_in` (..., n) from the sonars; `cos_incidence` (..., n), the cosine between ray and normal (its sign says
    from which side); `points_in` (..., n, 2), from the robot's position to the point met, in the frame of the map.
    """

    ranges_in: Floats
    cos_incidence: Floats
    points_in: Floats


@dataclass(frozen=True, slots=True)
class WallMap:
    """The walls a filter knows: `segments` (m, 4) for the ray caster and `lines` (m + 1, 3) of unit normal and offset.

    The last line is no line (zeros): index -1, the ray caster's "nothing", leads there. `first_wall`: the caster for
    few rays.
    """

    segments: Floats
    lines: Floats
    first_wall: FirstWall = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "first_wall", FirstWall(self.segments))


@dataclass(frozen=True, slots=True)
class SonarModel(RangeNoise):
    """How a reading of an exact ray strays from its range, and which readings are no measurement."""


IDEAL_SONAR = SonarModel()
"""The thesis' sonars: exact but for gaussian noise, real-valued, without limits."""

WIRE_SONAR = SonarModel(rounding_var_in2=1.0 / 12.0, lowest_in=6.0, highest_in=255.0)
"""What the real interface gives: whole inches (a uniform error, variance 1/12) from 6 to 255."""


def wall_map(segments: npt.ArrayLike) -> WallMap:
    """The map of wall segments (m, 4), rows x1 y1 x2 y2 in inches. Raises ValueError on a wall without length."""
    walls = np.array(segments, dtype=np.float64).reshape(-1, 4)
    along = walls[:, 2:] - walls[:, :2]
    length = np.hypot(along[:, 0], along[:, 1])
    if not (length > 0).all():
        raise ValueError(f"wall {int(np.argmin(length > 0))} has no length: {walls[np.argmin(length > 0)]}")
    lines = np.zeros((len(walls) + 1, 3))
    lines[:-1, 0] = -along[:, 1] / length
    lines[:-1, 1] = along[:, 0] / length
    lines[:-1, 2] = (lines[:-1, :2] * walls[:, :2]).sum(axis=-1)
    return WallMap(walls, lines)


def ring(body: SonarRing, turret_offset_rad: float = 0.0) -> Beams:
    """All sonars of a body, number i in direction `turret_offset_rad` + its own angle from the heading.

    On a synchro drive the heading is the steering's, so the offset is the turret's encoder less the steering's; on a
    Scout it is 0.
    """
    angles = turret_offset_rad + np.asarray(body.sonar_angles_rad, dtype=np.float64)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return Beams(np.zeros_like(directions), directions, body.sonar_ring_radius_in)


def pick(beams: Beams, numbers: npt.ArrayLike) -> Beams:
    """Some of the beams, by number: an int for one, or a list."""
    chosen = np.atleast_1d(np.asarray(numbers, dtype=np.intp))
    return Beams(beams.axes_in[..., chosen, :], beams.directions[..., chosen, :], beams.standoff_in)


def fired_at(beams: Beams, displacement: Floats) -> Beams:
    """The beams as they lie in the frame of the pose at hand, each fired from another pose.

    `displacement` (..., n, 3), or (3,) for all: the pose at the firing instant in the frame of the pose at hand
    (inches ahead, inches to the left, radians), taken from odometry; the noise of that short way is left out.
    """
    there = rays(np.broadcast_to(displacement, (*np.broadcast_shapes(displacement.shape[:-1], (1,)), 3)), beams)
    return Beams(there.axes_in, there.directions, beams.standoff_in)


def left_of(vectors: Floats) -> Floats:
    """Vectors (..., 2) turned by a quarter, counter-clockwise."""
    turned = np.empty(vectors.shape)
    turned[..., 0] = -vectors[..., 1]
    turned[..., 1] = vectors[..., 0]
    return turned


def rays(poses: Floats, beams: Beams) -> Rays:
    """The n beams laid out in the map from poses (..., n, 3), a pose a beam, or (..., 1, 3), one for all."""
    heading = poses[..., HEADING, None]
    cos, sin = np.cos(heading), np.sin(heading)
    arms = cos * beams.axes_in + sin * beams.axes_left
    return Rays(poses[..., :2] + arms, cos * beams.directions + sin * beams.directions_left, arms, beams.standoff_in)


def meet(aimed: Rays, walls: WallMap) -> Indices:
    """The index (..., n) of the first wall each ray meets, -1 where there is none.

    Looked for from the axis, not from the ring: a wall within the ring is still the first wall.
    """
    hit: Indices = cast_rays(aimed.axes_in, aimed.directions, walls.segments)[1]
    return hit


def sight(aimed: Rays, lines: Floats) -> Sight:
    """Rays against lines (..., n, 3) of unit normal and offset, each beam against its own."""
    normal_x, normal_y = lines[..., 0], lines[..., 1]
    cosine = normal_x * aimed.directions[..., 0] + normal_y * aimed.directions[..., 1]
    np.copyto(cosine, np.nan, where=cosine == 0.0)
    left = lines[..., 2] - normal_x * aimed.axes_in[..., 0] - normal_y * aimed.axes_in[..., 1]
    from_axis = left / cosine
    points = aimed.arms_in + from_axis[..., None] * aimed.directions
    return Sight(from_axis - aimed.standoff_in, cosine, points)


def range_jacobian(seen: Sight, lines: Floats) -> Floats:
    """d range / d (x, y, theta), (..., n, 3), of what was seen of lines (..., n, 3).

    Differentiating the range of the module's head gives, with w from the robot's position to the point met,
    d range = ((n_x w_y - n_y w_x) dtheta - normal . dp) / (normal . direction).
    """
    jacobian = np.empty((*seen.ranges_in.shape, 3))
    np.negative(lines[..., :2], out=jacobian[..., :2])
    jacobian[..., 2] = lines[..., 0] * seen.points_in[..., 1] - lines[..., 1] * seen.points_in[..., 0]
    jacobian /= seen.cos_incidence[..., None]
    return jacobian
