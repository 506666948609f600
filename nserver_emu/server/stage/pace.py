"""How simulated time goes along with real time: a value that the daemon follows and `sim_control` changes. No clock.

    real time        factor x the real seconds that passed; factor None: as fast as it can
    paused           time stands until `resume`, but for single steps
    lockstep         time moves by `lockstep_s` when a client asks something, and at no other moment
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

SLOWEST: Final = 0.1
FASTEST: Final = 999.0
LONGEST_LOCKSTEP_S: Final = 10.0
"""The longest step in lockstep, simulated seconds."""
AS_FAST_AS_IT_CAN: Final = 9999
"""What State[0] shows where the simulated time runs as fast as it can."""


@dataclass(slots=True)
class Pace:
    """See the head of this file; `factor` within SLOWEST..FASTEST, `lockstep_s` None or above 0."""

    factor: float | None = 1.0
    paused: bool = False
    lockstep_s: float | None = None

    def check(self) -> None:
        """Raises ValueError where this is no pace: a value that came from outside may be anything."""
        steps = (self.factor, SLOWEST, FASTEST), (self.lockstep_s, 0.0, LONGEST_LOCKSTEP_S)
        for value, low, high in steps:
            if value is not None and (isinstance(value, bool) or not low <= value <= high):
                raise ValueError(f"a pace of {value}")
        if not isinstance(self.paused, bool) or self.lockstep_s == 0.0:
            raise ValueError("a pace that neither passes nor stands")

    @property
    def runs_alone(self) -> bool:
        """Whether time passes by itself."""
        return not self.paused and self.lockstep_s is None

    @property
    def asked_s(self) -> float:
        """Simulated seconds that pass because a client asks something."""
        return 0.0 if self.paused or self.lockstep_s is None else self.lockstep_s

    @property
    def speed_tenths(self) -> int:
        """State[0]: the factor x 10, 0 when paused or in lockstep, 9999 for as fast as it can."""
        if not self.runs_alone:
            return 0
        return AS_FAST_AS_IT_CAN if self.factor is None else round(10 * self.factor)
