"""A piece of motion while it lasts, and the moments in it: what the encoders say at any instant, by the closed form.

A robot's wheels move once for a whole piece; what happens inside it, a sonar firing, notes the piece and how far into
it that was. The stamp is worked out when somebody asks for it. Values only: a moment tells the same whenever asked.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from nserver_emu.simulation.angles import once_round
from nserver_emu.simulation.axis import Run, shown_in
from nserver_emu.simulation.poses import Pose, Stamp
from nserver_emu.simulation.stretch import Stretch

AT_REST: Final = Stretch(0.0, 0.0, 0.0, 0.0, 0.0)
"""The stretch of a passage of which only the beginning is asked for."""


class Passage(NamedTuple):
    """The encoders at the beginning of a stretch, and how they go on.

    x_in, y_in, heading_rad     what they say, the heading unwrapped
    stretch                     what the wheels were told
    runs                        of the axes in their order
    """

    x_in: float
    y_in: float
    heading_rad: float
    stretch: Stretch
    runs: tuple[Run, Run, Run]


class Moment(NamedTuple):
    """So many seconds into a passage; `turret_rad` is what the encoder of the turret says there, unwrapped.

    instant_s    simulated time
    """

    passage: Passage
    time_s: float
    turret_rad: float
    instant_s: float

    @property
    def stamp(self) -> Stamp:
        """What a reading of this moment is stamped with."""
        (x, y, heading, stretch, (first, second, third)), time_s, turret, instant_s = self
        dx, dy = stretch.displacement(heading, time_s)
        pose = Pose(x + dx, y + dy, once_round(heading + stretch.turn_at(time_s)), once_round(turret))
        velocities = shown_in(first, time_s), shown_in(second, time_s), shown_in(third, time_s)
        return Stamp(pose, velocities, instant_s, instant_s)
