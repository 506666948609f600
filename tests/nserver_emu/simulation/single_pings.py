"""The acoustic model for one ping at a time."""

from __future__ import annotations

from collections.abc import Sequence

from nserver_emu.simulation.acoustics import Ping, Polaroid, ReflectorMap
from worlds.geometry import NO_DISCS, FloatArray
from worlds.robots import Body


def first_echo_in(
    model: Polaroid, ping: Ping, earlier: Sequence[Ping], reflectors: ReflectorMap, body: Body,
    others: FloatArray = NO_DISCS,
) -> float:  # fmt: skip
    """Return the range of the first echo of one ping."""
    return model.first_echo_in(ping, earlier, reflectors, body, others)


def measured_range(model: Polaroid, ping: Ping, earlier: Sequence[Ping], reflectors: ReflectorMap, body: Body) -> float:
    """Return the measured range of one ping."""
    return model.measured_range(ping, earlier, reflectors, body)
