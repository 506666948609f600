"""What a robot does that no longer knows where it is: stand, search or give up, for so long.

    search    a turn about, for other sonars hear other walls; then, while several places look alike, a little way
              where the most room is, and a turn again

Rules: the ring's own readings alone say where there is room; slow, stopped by a touch; ends by lost_s.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, cycle
from math import copysign, pi, tau
from typing import Final

from localization.missions.failures import MissionOver
from localization.missions.helm import Helm
from localization.missions.settings import OnLost, Settings
from localization.planning.course import turn_between
from localization.planning.following import STAND, TURNED_RAD, Velocities
from localization.watch import Trust

TURN_RAD_S: Final = 0.4
DRIVE_IN_S: Final = 3.0
WAY_IN: Final = 15.0
ROOM_IN: Final = 18.0
"""What the ring must read ahead, and a little to either side, to go that way."""
_PERIODS: Final = 10_000


def find_again(helm: Helm, settings: Settings, reason: str) -> None:
    """Do as the settings say; returns once the place is known. Raises MissionOver."""
    if settings.on_lost is OnLost.GIVE_UP:
        raise MissionOver("lost", reason)
    until_s = helm.clock_s + settings.lost_s
    commands = _searching(helm) if settings.on_lost is OnLost.SEARCH else cycle([STAND])
    while helm.sight.estimate.verdict.trust is Trust.LOST:
        if helm.clock_s > until_s:
            raise MissionOver("lost", f"not found again in {settings.lost_s:g} s: {helm.sight.estimate.verdict.reason}")
        helm.period(next(commands))


def _searching(helm: Helm) -> Iterator[Velocities]:
    """Commands without end."""
    for about in chain([tau], cycle([pi])):
        yield from _turning(helm, about)
        yield from _turning(helm, _roomiest(helm))
        yield from _driving(helm)


def _turning(helm: Helm, by_rad: float) -> Iterator[Velocities]:
    """Turn by so much, by the encoders."""
    left, before = by_rad, helm.sight.state.steering_rad
    while abs(left) > TURNED_RAD:
        yield Velocities(0.0, copysign(min(TURN_RAD_S, abs(left) + 0.05), left))
        now = helm.sight.state.steering_rad
        left, before = left - turn_between(before, now), now


def _driving(helm: Helm) -> Iterator[Velocities]:
    """Drive ahead while there is room; back a little from a touch."""
    start = helm.sight.state
    while not helm.sight.state.touching and _room_ahead(helm) >= ROOM_IN:
        state = helm.sight.state
        if (state.x_in - start.x_in) ** 2 + (state.y_in - start.y_in) ** 2 >= WAY_IN**2:
            break
        yield Velocities(DRIVE_IN_S, 0.0)
    yield STAND
    if helm.sight.state.touching:
        for _ in range(15):
            yield Velocities(-DRIVE_IN_S, 0.0)


def _room_ahead(helm: Helm) -> float:
    return _room(helm, 0.0)


def _roomiest(helm: Helm) -> float:
    """The turn, among the ring's directions, to where the most room is."""
    turns = [turn_between(0.0, k * tau / 16.0) for k in range(16)]
    return max(turns, key=lambda turn: (_room(helm, turn), -abs(turn)))


def _room(helm: Helm, turn_rad: float) -> float:
    """The shortest reading of the sonars within 45 degrees of a direction from the heading."""
    state = helm.sight.state
    front = state.turret_rad - state.steering_rad
    angles = helm.body.sonar_angles_rad
    near = zip(angles, state.sonars_in, strict=True)
    return min(reading for angle, reading in near if abs(turn_between(turn_rad, front + angle)) <= pi / 4.0 + 0.01)
