"""What a Polaroid transducer hears: the echo model of the setup `measured`. Pure: cries, walls and chance come in.

Smooth walls are mirrors for sound: of a wall comes back what meets it head-on, of a slanted one nothing but what it
mirrors. The ways of sound are found exactly, off walls and edges in echo_ways.py, off other robots in disc_ways.py.

Of each way that is free and leaves and comes in inside the cone, a level is known; the first that is loud enough is
heard. A cry of another sonar of the ring that is still under way is heard like one's own, and as too short a range.
Left out: side lobes, ways off three walls and more, cries later than one's own, cries of other robots, rough walls.
"""

from __future__ import annotations

from cmath import rect
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf, radians
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation import disc_ways, echo_ways
from nserver_emu.simulation.echo_ways import Beam, Losses, Scene, Way
from nserver_emu.simulation.instants import to_s
from worlds.bodies import SONARS, Body
from worlds.geometry import FloatArray

NO_ROBOTS: Final[FloatArray] = np.zeros((0, 3))


class Cry(NamedTuple):
    """A sonar fired: the axis of its ring, its direction, when, and the standard normal numbers of its chance."""

    x_in: float
    y_in: float
    direction_rad: float
    instant_ps: int
    chances: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Polaroid:
    """The parameters of the model. Levels are against a wall met head-on close by, inches and decibels.

    cone_rad          whole angle of the cone inside which a transducer cries and hears
    std_share         standard deviation of a range as a share of it; never below least_std_in
    sound_in_s        speed of sound: 343 m/s, air at 20 degrees C
    margin_db         how much louder than just audible that wall is; in each cry a draw with margin_std_db about it
    cone_loss_db      lost at the rim of the cone, out and back together; with the square of the angle in between
    way_loss_db_in    lost an inch of range: absorption, and what the receiver's rising gain leaves of the spreading
    bounce_loss_db    lost at each wall after the first
    edge_loss_db      lost at an edge, against a wall
    skin_loss_db      lost at the broken skin of another robot, against a wall, where it does not face the transducer
    blanking_in       echoes from nearer drown in the transducer's own ringing: an own one reads this, others nothing
    recess_in         the transducer's face lies so deep behind the ring
    dead              sonars that read 0
    offsets_in        what each sonar reads more than that, always
    turned_rad        the ring stands turned by this against the turret
    """

    cone_rad: float = radians(25.0)
    std_share: float = 0.01
    least_std_in: float = 0.05
    sound_in_s: float = 13504.0
    margin_db: float = 30.0
    margin_std_db: float = 2.0
    cone_loss_db: float = 12.0
    way_loss_db_in: float = 0.1
    bounce_loss_db: float = 3.0
    edge_loss_db: float = 15.0
    skin_loss_db: float = 15.0
    blanking_in: float = 6.0
    recess_in: float = 0.5
    dead: tuple[int, ...] = ()
    offsets_in: tuple[float, ...] = (0.0,) * SONARS
    turned_rad: float = 0.0

    @property
    def life_ps(self) -> int:
        """After this a cry can be heard no more, even when chance favours it by five standard deviations."""
        reach_in = (self.margin_db + 5.0 * self.margin_std_db) / self.way_loss_db_in
        return int(2.0 * reach_in / self.sound_in_s * 1e12)

    def draw(self, chance: np.random.Generator) -> tuple[float, ...]:
        """The chance of one cry: for the range, and for the level. Always two numbers."""
        range_chance, level_chance = chance.standard_normal(2).tolist()
        return range_chance, level_chance

    def heard_in(
        self, cry: Cry, earlier: Sequence[Cry], scene: Scene, body: Body, others: FloatArray = NO_ROBOTS
    ) -> float:
        """The range that a sonar makes of what it hears, inches from the ring; inf for nothing.

        earlier    cries of the same ring before it, of the last `life_ps`
        others     where other robots stand (k, 3), rows x y radius in inches
        """
        range_in = self.first_in(cry, earlier, scene, body, others)
        if range_in == inf:
            return inf
        return range_in + cry.chances[0] * max(self.std_share * range_in, self.least_std_in)

    def first_in(
        self, cry: Cry, earlier: Sequence[Cry], scene: Scene, body: Body, others: FloatArray = NO_ROBOTS
    ) -> float:
        """The range of the first echo that is loud enough, before noise; inf for none."""
        margin_db = self.margin_db + self.margin_std_db * cry.chances[1]
        found: list[tuple[float, Way]] = []
        back = self._beam(cry, body)
        for source in (cry, *earlier):
            own = source is cry
            head_start_in = self.sound_in_s * to_s(cry.instant_ps - source.instant_ps)
            nearest_in = -inf if own else self.blanking_in
            if self.way_loss_db_in * (nearest_in + head_start_in / 2.0) > margin_db:
                continue
            for way in self._ways(self._beam(source, body), back, scene, others, own=own):
                range_in = (way.length_in - head_start_in) / 2.0 - self.recess_in
                if way.loss_db <= margin_db and range_in >= nearest_in:
                    found.append((range_in, way))
        for range_in, way in sorted(found, key=lambda pair: pair[0]):
            if echo_ways.free(way.points, scene.walls, others):
                return range_in
        return inf

    def _ways(self, out: Beam, back: Beam, scene: Scene, others: FloatArray, *, own: bool) -> Iterator[Way]:
        lost = Losses(self.way_loss_db_in, self.bounce_loss_db, self.edge_loss_db, self.skin_loss_db)
        yield from echo_ways.ways(out, back, scene, lost, own=own)
        if len(others):
            yield from disc_ways.ways(out, back, others, out.may_meet(scene.mirrors), lost, own=own)

    def _beam(self, cry: Cry, body: Body) -> Beam:
        return Beam(self._face(cry, body), cry.direction_rad, self.cone_rad / 2.0, self.cone_loss_db / 2.0)

    def _face(self, cry: Cry, body: Body) -> complex:
        """Where the transducer is."""
        return complex(cry.x_in, cry.y_in) + rect(body.sonar_ring_radius_in - self.recess_in, cry.direction_rad)
