"""The batteries: 12 V that last about six hours. Pure: time in, volts out; both batteries drain alike.

Decision of ours, for no source gives the curve: from 12.0 V down to 10.8 V in six hours on a straight line, and no
lower; driving costs nothing extra.
"""

from __future__ import annotations

from typing import Final

FULL_V: Final = 12.0
EMPTY_V: Final = 10.8
LASTS_S: Final = 6 * 3600.0


def battery_v(time_s: float) -> float:
    """Volts, so many seconds after the batteries were full."""
    return max(EMPTY_V, FULL_V - (FULL_V - EMPTY_V) * time_s / LASTS_S)
