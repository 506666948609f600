"""Modules and compiled code of worker processes, loaded once: the process that forks them imports this module."""

import sys
from contextlib import suppress
from importlib.metadata import PackageNotFoundError

from localization.experiments import live_trial  # noqa: F401 - most experiments drive its robots
from localization.filters import compiled
from localization.filters.base import THESIS_ODOMETRY
from localization.filters.filter_loop import filter_config
from localization.filters.health import HealthLimits
from localization.filters.sonar_cone import ConeModel, ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RayModel
from nclient.errors import VariableError
from nserver_emu.server import inprocess  # noqa: F401 - found by entry point otherwise
from nserver_emu.simulation.acoustics import FIRST_ECHO
from worlds.robots import N150


def load_compiled_code() -> None:
    """Load compiled code of filter and sonars that is on disk; compile that of sonars where it is asked for or seen."""
    # Compiled code takes any map: a single wall here.
    walls = [(0.0, 100.0, 100.0, 100.0)]
    for model in (RayModel(walls, N150, WIRE_SONAR), ConeModel(walls, N150, ConeSonar())):
        if compiled.is_on_disk(model.update):
            compiled.filter_of(filter_config(THESIS_ODOMETRY, model, HealthLimits()))
    # A sixth of a trial with measured sonars; most experiments have those.
    FIRST_ECHO.prepare(is_used=True)


# Where SciPy is installed, numba loads all of its linear algebra, which no compiled formula calls. Workers that need
# SciPy import it later.
_HIDDEN = sys.modules.setdefault("scipy", None) is None  # type: ignore[arg-type]
# Without numba all is plain. A wrong variable is reported by the work itself.
with suppress(PackageNotFoundError, VariableError):
    load_compiled_code()
if _HIDDEN:
    del sys.modules["scipy"]
