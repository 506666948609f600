"""Position stamps: where the robot was, by its encoders, when a sensor took its reading.

    x y steer turret | v_trans v_steer v_turret | pose time ms | sensor time ms      nine numbers, wire units

The order of the stamps in a reply: 16 infrared, 16 sonar, bumper, laser, compass.
"""

from __future__ import annotations

from typing import NamedTuple

from nclient.protocol.mask import Position


class Stamp(NamedTuple):
    """One position stamp in wire units (tenths of inches and degrees, milliseconds)."""

    x: int
    y: int
    steer: int
    turret: int
    v_trans: int
    v_steer: int
    v_turret: int
    pose_time: int
    sensor_time: int


NO_STAMP = Stamp(0, 0, 0, 0, 0, 0, 0, 0, 0)
"""What a sensor carries that has not read yet."""

INFRARED_KEYS = tuple(f"ir_{i}" for i in range(16))
SONAR_KEYS = tuple(f"sonar_{i}" for i in range(16))

STAMP_KEYS: dict[Position, tuple[str, ...]] = {
    Position.INFRARED: INFRARED_KEYS,
    Position.SONAR: SONAR_KEYS,
    Position.BUMPER: ("bumper",),
    Position.LASER: ("laser",),
    Position.COMPASS: ("compass",),
}
"""The names of the stamps that each position-data bit asks for, in the order of the wire."""
