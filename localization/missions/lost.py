"""What a mission does whose robot no longer knows where it is: stand, search (groping) or give up, for so long.

Rules: how it is searched is groping's, the same for all commands; a touch sets the robot back a little, and it looks
around anew. Ends by lost_s.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle
from typing import Final

from localization.driving.groping import DRIVE_IN_S, Groping
from localization.driving.navigation import PERIOD_S
from localization.filters.health import HealthStatus
from localization.missions.failures import MissionOver
from localization.missions.helm import Helm
from localization.missions.settings import OnLost, Settings
from localization.planning.following import STAND, Velocities

BACK_S: Final = 1.5


def find_again(helm: Helm, settings: Settings, reason: str) -> None:
    """Do as the settings say; returns once the place is known. Raises MissionOver."""
    if settings.on_lost is OnLost.GIVE_UP:
        raise MissionOver("lost", reason)
    until_s = helm.clock_s + settings.lost_s
    commands = _searching(helm) if settings.on_lost is OnLost.SEARCH else cycle([STAND])
    while helm.sight.estimate.health.status is HealthStatus.LOST:
        if helm.clock_s > until_s:
            raise MissionOver("lost", f"not found again in {settings.lost_s:g} s: {helm.sight.estimate.health.reason}")
        helm.period(next(commands))


def _searching(helm: Helm) -> Iterator[Velocities]:
    """Commands without end."""
    groping = Groping(PERIOD_S)
    while True:
        if helm.sight.state.touching:
            yield from [Velocities(-DRIVE_IN_S, 0.0)] * round(BACK_S / PERIOD_S)
            groping.reset()
        yield Velocities(*groping.command(helm.sight.state))
