"""The sonar ring: which sonar fires when, and what it reads. Rays are the world's; poses and time are handed in.

    order 0 2 15 1 ..., rate 15:    0 fires at 0 ms, 2 at 60 ms, 15 at 120 ms, 1 at 180 ms ... and round again

A firing notes where it happened and draws its chance; the echo is sought when somebody looks, or when the walls are
about to change. So a ring nobody reads costs nothing, and reading it earlier or later changes no reading. What is heard
is an echo model's: SonarNoise, one exact ray with noise, or Polaroid (polaroid.py), with all that a real ring does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, floor, inf, sin
from typing import Final, NamedTuple

import numpy as np

from nserver_emu.simulation.acoustics import Cry, Polaroid, Scene
from nserver_emu.simulation.segments import NEVER_PS, PS_PER_S, Moment, Pose, Stamp
from nserver_emu.simulation.visibility import FARTHEST_IN, NOBODY_NEAR, Eye, on_lines
from worlds.geometry import FloatArray
from worlds.raycast import NEAREST_OBSTACLE, cast_each, ray_to_disc
from worlds.robots import SONARS, Body

NEAREST_IN: Final = 6
"""A wall nearer than this reads this: the transducer still rings from its own cry."""

NOTHING_IN: Final = 255
"""No echo, or one from farther away."""

TICK_PS: Final = 4 * PS_PER_S // 1000
"""The unit of the firing rate, 4 ms."""

SLOWEST_RATE: Final = 255
"""The largest rate that the robot's line can carry, in a byte."""

DEFAULT_ORDER: Final = (0, 2, 15, 1, 14, 3, 13, 4, 12, 5, 11, 6, 10, 7, 9, 8)
DEFAULT_RATE: Final = 15
"""The ring is on at power-on: programs written for Nserver never configure it."""

UNFIRED: Final = Stamp(Pose(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)
"""The moment of a reading that never was."""


@dataclass(frozen=True, slots=True)
class SonarNoise:
    """One exact ray, and gaussian noise of its range: std_share of it, at least least_std_in; none where both are 0.

    `dead`: sonars that read 0; `offsets_in`: what each reads more than the range, always; `turned_rad`: the ring stands
    turned by this against the turret.
    """

    std_share: float = 0.0
    least_std_in: float = 0.0
    dead: tuple[int, ...] = ()
    offsets_in: tuple[float, ...] = (0.0,) * SONARS
    turned_rad: float = 0.0

    def std_in(self, range_in: float) -> float:
        """Standard deviation at a range, inches."""
        return max(self.std_share * range_in, self.least_std_in)

    @property
    def life_ps(self) -> int:
        """Rays know nothing of one another: a cry is over at once."""
        return 0

    def draw(self, chance: np.random.Generator) -> tuple[float, ...]:
        """The chance of one cry: one number, or none where there is no noise."""
        return (chance.standard_normal(),) if self.least_std_in or self.std_share else (0.0,)

    def heard_in(self, cries: Sequence[Cry], eyes: Sequence[Eye], walls: FloatArray, body: Body) -> list[float]:
        """The range from the ring along each ray, to a wall (m, 4) or a robot, with its noise, inches; inf for nothing.

        How many rays come at once changes no bit.
        """
        if NEAREST_OBSTACLE.run is not None:
            from_axis = [_met(NEAREST_OBSTACLE.run, cry, eye, walls) for cry, eye in zip(cries, eyes, strict=True)]
            return self._from_ring(from_axis, cries, body)
        ways = [complex(cos(cry.direction_rad), sin(cry.direction_rad)) for cry in cries]
        from_axis = cast_each([complex(cry.x_in, cry.y_in) for cry in cries], ways, walls)
        for ray, disc in on_lines(eyes, ways, from_axis.copy()):
            met = ray_to_disc(cries[ray].x_in, cries[ray].y_in, ways[ray].real, ways[ray].imag, disc)
            from_axis[ray] = min(from_axis[ray], met)
        return self._from_ring(from_axis, cries, body)

    def _from_ring(self, from_axis: Sequence[float], cries: Sequence[Cry], body: Body) -> list[float]:
        ring_in = body.sonar_ring_radius_in
        if not (self.least_std_in or self.std_share):
            return [far - ring_in for far in from_axis]
        return [self._misheard(far - ring_in, cry) for far, cry in zip(from_axis, cries, strict=True)]

    def _misheard(self, range_in: float, cry: Cry) -> float:
        chance = cry.chances[0]
        return range_in + chance * self.std_in(range_in) if chance and range_in < inf else range_in


def _met(nearest_obstacle: Callable[..., float], cry: Cry, eye: Eye, walls: FloatArray) -> float:
    """The range from the axis to the first wall or robot, by the machine code."""
    way, seen = cry.direction_rad, eye.seen
    robots, widest_in = (seen.sorted, seen.widest_in) if len(seen.discs) > 1 else (NOBODY_NEAR, 0.0)
    return nearest_obstacle(cry.x_in, cry.y_in, cos(way), sin(way), walls, robots, eye.own, widest_in, FARTHEST_IN)


EchoModel = SonarNoise | Polaroid
"""How a setup's sonars hear: `draw` and `heard_in`, `life_ps`, and which are `dead`."""

DEAD_IN: Final = 0
"""What a dead sonar reads, always."""


class Firing(NamedTuple):
    """A cry whose echo nobody has looked at, those before it that may still be under way, and the eye it left from."""

    cry: Cry
    earlier: tuple[Cry, ...]
    eye: Eye


class SonarRing:
    """Sixteen sonars that fire one after another; see the head of this file."""

    def __init__(self, body: Body, model: EchoModel, walls: FloatArray, chance: np.random.Generator) -> None:
        self.body = body
        self.model = model
        self._scene = Scene(walls)
        self._chance = chance
        self._readings = [DEAD_IN if sonar in model.dead else NOTHING_IN for sonar in range(SONARS)]
        self._moments: list[Stamp | Moment] = [UNFIRED] * SONARS
        self._cries: list[Cry | None] = [None] * SONARS
        self._unheard: dict[int, Firing] = {}
        self._recent: tuple[Cry, ...] = ()
        self._order: tuple[int, ...] = ()
        self._interval_ps = self._count = 0
        self.due_ps = NEVER_PS
        """When the next sonar fires; NEVER_PS if the ring is off."""

    @property
    def readings_in(self) -> tuple[int, ...]:
        """The last reading of each sonar: 16 whole inches from the ring, 6..255, 255 where nothing was met;
        0 where dead."""
        self._listen()
        return tuple(self._readings)

    @property
    def stamps(self) -> tuple[Stamp, ...]:
        """The moment of each of those readings."""
        return tuple(moment if isinstance(moment, Stamp) else moment.stamp for moment in self._moments)

    @property
    def cries(self) -> tuple[Cry | None, ...]:
        """The cry of each of those readings: where the ring really was, and which way the sonar pointed; None where it
        has not cried since the robot was carried here."""
        return tuple(self._cries)

    def carried(self) -> None:
        """The robot was set down elsewhere: readings stay, but nothing that was cried has to do with this place."""
        self._cries = [None] * SONARS

    def configure(self, rate: int, order: Sequence[int], now_ps: int) -> None:
        """Restart the ring: entry k of the order is due 4 ms x rate x k from now, and round again.

        rate     clamped to 1..255
        order    sonar numbers, ends at the first that is none (255 by custom); none at all: the ring is off, and
                 readings stay what they were
        """
        end = next((at for at, sonar in enumerate(order) if not 0 <= sonar < SONARS), len(order))
        self._order = tuple(order[:end])
        self._interval_ps = min(max(rate, 1), SLOWEST_RATE) * TICK_PS
        self._count = 0
        self.due_ps = now_ps if self._order else NEVER_PS

    def check(self) -> None:
        """Raises ValueError where the ring would never stop firing: what came from outside may be anything."""
        if not TICK_PS <= self._interval_ps <= SLOWEST_RATE * TICK_PS or not (self._order or self.due_ps == NEVER_PS):
            raise ValueError("a ring of sonars without an interval or an order")

    def fire_due(self, eye: Eye, moment: Stamp | Moment) -> None:
        """The sonar that is due fires here and now."""
        sonar, instant_ps, life_ps = self._order[self._count % len(self._order)], self.due_ps, self.model.life_ps
        if life_ps:
            self._recent = tuple(cry for cry in self._recent if instant_ps - cry.instant_ps < life_ps)
        cry = self._fire(sonar, eye, moment, instant_ps, self._recent)
        if life_ps:
            self._recent = (*self._recent, cry)
        self._count += 1
        self.due_ps += self._interval_ps

    def fire_all(self, eye: Eye, moment: Stamp | Moment) -> None:
        """All sixteen as at power-on, each as if it were alone."""
        for sonar in range(SONARS):
            self._fire(sonar, eye, moment, 0, ())

    def surround(self, walls: FloatArray) -> None:
        """From now on these are the walls (m, 4); what was fired before still meets the old ones."""
        self._listen()
        self._scene = Scene(walls)

    def hear_as(self, model: EchoModel) -> None:
        """From now on they hear like this; what was fired before is heard as before, and disturbs nothing new."""
        self._listen()
        self._recent = ()
        self.model = model
        for sonar in model.dead:
            self._readings[sonar] = DEAD_IN

    def _fire(
        self, sonar: int, eye: Eye, moment: Stamp | Moment, instant_ps: int, earlier: tuple[Cry, ...]
    ) -> Cry:
        x, y, turret_rad, _, _ = eye
        way_rad = turret_rad + self.model.turned_rad + self.body.sonar_angles_rad[sonar]
        cry = Cry(x, y, way_rad, instant_ps, self.model.draw(self._chance))
        self._unheard[sonar] = Firing(cry, earlier, eye)
        self._moments[sonar] = moment
        self._cries[sonar] = cry
        return cry

    def _listen(self) -> None:
        """Hear the echoes of all firings since the last look. How many they are changes no reading."""
        if not self._unheard:
            return
        dead, offsets_in, firings = self.model.dead, self.model.offsets_in, self._unheard
        if dead:
            firings = {sonar: firing for sonar, firing in firings.items() if sonar not in dead}
        for sonar, heard_in in zip(firings, self._heard_in(list(firings.values())), strict=True):
            self._readings[sonar] = _reading(heard_in + offsets_in[sonar])
        self._unheard.clear()

    def _heard_in(self, firings: Sequence[Firing]) -> list[float]:
        """Ranges, inches, inf for nothing."""
        model, scene, body = self.model, self._scene, self.body
        if isinstance(model, SonarNoise):
            return model.heard_in([firing.cry for firing in firings], [f.eye for f in firings], scene.walls, body)
        return [model.heard_in(cry, earlier, scene, body, eye.others) for cry, earlier, eye in firings]


def _reading(heard_in: float) -> int:
    """What a sonar reads of a range from the ring, a fraction rounded to the nearest whole inch."""
    if heard_in >= NOTHING_IN:
        return NOTHING_IN
    return floor(heard_in + 0.5) if heard_in >= NEAREST_IN else NEAREST_IN
