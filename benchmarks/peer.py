"""The benchmark's scene in ir-sim: one round robot that drives in a circle between 50 walls and casts 16 rays.

Common to both: room, walls, radius of the robot, velocities, steps of 0.1 s, 16 ranges read after each step, a
collision test, one process without a window. Different: ir-sim casts all 16 rays in each step and integrates the pose
by Euler's method; this simulation fires its sonars one after another, each at its own time and pose, follows the arc
exactly and stops at contact. So it is timed twice: at the usual rate of the ring, 1.7 rays per step, and at its
highest, 25.
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from nserver_emu.simulation.models import N150
from worlds.world import World

M_PER_IN: Final = 0.0254
INSTALL: Final = "ir-sim is not installed: pip install -e '.[bench]'"
SPEED_IN_S, TURN_RAD_S = 10.0, 0.75
"""A circle of 13 in radius around a point with 40 in of free space."""


def peer(world: World) -> Callable[[int], None] | None:
    """Return a function that executes a number of steps of 0.1 s in ir-sim; None if it is not installed."""
    # A backend without a window; ir-sim prints while it is imported.
    os.environ.setdefault("MPLBACKEND", "Agg")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            import irsim
        except ImportError:
            return None
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "scene.yaml")
            path.write_text(_yaml(world), encoding="utf-8")
            env: Any = irsim.make(str(path), display=False, save_ani=False, log_level="ERROR")
    action = np.array([[SPEED_IN_S * M_PER_IN], [TURN_RAD_S]])

    def run(steps: int) -> None:
        for _ in range(steps):
            env.step(action)
            assert len(env.get_lidar_scan()["ranges"]) == 16
        # A collision would stop ir-sim's robot, and the rest would be cheap.
        assert not env.robot.collision

    return run


def _yaml(world: World) -> str:
    """Return the scene in ir-sim's file format, in metres and radians."""
    size = M_PER_IN * float(np.abs(world.walls).max()) * 2.0 + 1.0
    walls = "\n".join(
        f"  - {{shape: {{name: linestring, vertices: [[{x1:.9f}, {y1:.9f}], [{x2:.9f}, {y2:.9f}]]}}, state: [0, 0, 0]}}"
        for x1, y1, x2, y2 in (M_PER_IN * world.walls).tolist()
    )
    return f"""
world: {{width: {size}, height: {size}, offset: [{-size / 2}, {-size / 2}], step_time: 0.1, sample_time: 0.1}}
robot:
  - kinematics: {{name: diff}}
    shape: {{name: circle, radius: {N150.body.radius_in * M_PER_IN}}}
    state: [0, 0, 0]
    vel_max: [1.0, 1.6]
    sensors:
      - {{type: lidar2d, range_min: 0, range_max: {255 * M_PER_IN}, angle_range: 6.283185307, number: 16}}
obstacle:
{walls}
"""
