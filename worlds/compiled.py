"""A kernel of ray.py as machine code, by numba, where that is installed and worth its while; else everybody's own way.

Machine code does the same operations on the same numbers in the same order (no fast math, no fused products): its
results are those of the arrays to the bit. So whether and when it is used changes how long a simulation takes, and
nothing else.

    pip install 'nomad-nserver[fast]'       numba
    NOMAD_COMPILED=always|crowd|never       from the first robot on; from CROWD robots on (the default); not at all

Loading takes a process about a second: numba is imported, and its code read from the cache beside the source
or, the first time, made. A few robots in real time would never win that back.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, Final

from nclient.errors import VariableError
from worlds import ray

VARIABLE: Final = "NOMAD_COMPILED"
"""The environment variable."""

CROWD: Final = 50
"""Where each ring is read once a second, so many robots win back the loading within a minute."""

_FROM_ROBOTS: Final = {"always": 1.0, "crowd": float(CROWD), "never": float("inf")}


class Kernel:
    """`run` is `ray.first_met` as machine code, or None as long as that is not loaded: its caller then works in arrays,
    which is quicker than the plain function."""

    def __init__(self) -> None:
        self.run: Callable[..., float] | None = None
        self.tried = False
        """Whether it was sought already; what cannot be found once is not sought again."""

    def load(self) -> bool:
        """Compile it or take it from the cache, once; returns whether there is machine code."""
        if not self.tried:
            self.tried = True
            try:
                import numba
                import numba.extending
            except ImportError:
                return False
            self.run = _compile(numba)
        return self.run is not None


FIRST_MET: Final = Kernel()
"""The one of this process."""


def load_for(robots: int) -> None:
    """Load the machine code if so many robots are worth it.

    Raises VariableError if the environment variable is none of its words.
    """
    word = os.environ.get(VARIABLE, "crowd")
    if word not in _FROM_ROBOTS:
        raise VariableError(f"{VARIABLE} is {word!r}; it can be {', '.join(_FROM_ROBOTS)}")
    if robots >= _FROM_ROBOTS[word]:
        FIRST_MET.load()


def _compile(numba: Any) -> Callable[..., float]:
    """`ray.first_met` for read-only arrays, which stand for all others too."""
    for helper in (ray.meeting, ray.meeting_before, ray.ray_to_disc, ray.first_wall):
        numba.extending.register_jitable(helper)
    number, rows = numba.float64, numba.types.Array(numba.float64, 2, "C", readonly=True)
    signature = number(number, number, number, number, rows, rows, numba.int64, number, number)
    try:
        compiled: Callable[..., float] = numba.njit(signature, cache=True)(ray.first_met)
    except RuntimeError:  # nowhere to keep a cache
        compiled = numba.njit(signature)(ray.first_met)
    return compiled
