"""The acoustic model for one ping at a time."""

from __future__ import annotations

from collections.abc import Sequence

from nserver_emu.simulation.acoustics import Ping, Polaroid, ReflectorMap, completed
from worlds.geometry import NO_DISCS, FloatArray
from worlds.robots import Body


def first_echo_in(
    model: Polaroid, ping: Ping, earlier: Sequence[Ping], reflectors: ReflectorMap, body: Body,
    others: FloatArray = NO_DISCS,
) -> float:  # fmt: skip
    """Return the range of the first echo of one ping."""
    (range_in,) = completed(model.first_echo_steps([ping], [earlier], reflectors, body, [others]))
    return range_in


def measured_range(model: Polaroid, ping: Ping, earlier: Sequence[Ping], reflectors: ReflectorMap, body: Body) -> float:
    """Return the measured range of one ping."""
    (range_in,) = completed(model.range_steps([ping], [earlier], reflectors, body, [NO_DISCS]))
    return range_in
