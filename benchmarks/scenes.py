"""The scenes of the simulation's benchmark: one robot or a crowd between walls, and how they roam.

A crowd's room grows with it: 100 in from robot to robot at the start, so that some meet and most do not.
"""

from __future__ import annotations

from math import ceil, pi, sin, sqrt
from typing import Final

import numpy as np

from nserver_emu.simulation.models import N150
from nserver_emu.simulation.noise import RobotSetup
from nserver_emu.simulation.simulation import Simulation
from worlds.geometry import FloatArray
from worlds.world import Polygon, StartPose, World

HALF_IN: Final = 240.0
WALLS: Final = 50
FREE_IN: Final = 55.0
"""Minimum distance from the middle of a 30 in wall to a start pose; it leaves 40 in free around the start."""
SPACING_IN: Final = 100.0


def room(half_in: float, walls: int, starts: FloatArray, free_in: float) -> World:
    """Return a square room with random 30 in walls, none near a start; `walls` includes the four of the room."""
    # More middles than walls: those near a start are discarded.
    rng = np.random.default_rng(150)
    middles = rng.uniform(-half_in, half_in, (8 * walls, 2))
    away = np.hypot(*(middles[:, None] - starts).T).min(axis=0)
    middles = middles[away > free_in][: walls - 4]
    angles = rng.uniform(0.0, pi, len(middles))
    half = 15.0 * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    corners = ((-half_in, -half_in), (half_in, -half_in), (half_in, half_in), (-half_in, half_in))
    return World("benchmark", rooms=(Polygon(corners),), inner_walls=np.hstack((middles - half, middles + half)))


def alone(setup: RobotSetup, walls: int = WALLS) -> Simulation:
    """One N150 in the middle of 480 in x 480 in."""
    simulation = Simulation(room(HALF_IN, walls, np.zeros((1, 2)), FREE_IN), seed=1)
    simulation.add_robot(1, setup=setup)
    return simulation


def crowd(robots: int, setup: RobotSetup, places_for: int = 0) -> Simulation:
    """So many N150 on a square grid between 50 walls, in a room for that many or more."""
    side = ceil(sqrt(max(robots, places_for)))
    half_in = 0.5 * SPACING_IN * side
    places = (np.arange(side) + 0.5) * SPACING_IN - half_in
    starts = np.array([(x, y) for y in places for x in places])[:robots]
    simulation = Simulation(room(half_in, WALLS, starts, 15.0 + N150.body.radius_in), seed=1)
    for number, (x, y) in enumerate(starts.tolist()):
        # 2.4 rad apart: neighbours drive in different directions.
        simulation.add_robot(number + 1, StartPose(x, y, 2.4 * number, 2.4 * number), setup=setup, powered=False)
    simulation.power_on()
    return simulation


def roam(simulation: Simulation, steps: int, dt_s: float, look_every: int) -> None:
    """Drive in arcs that change every twenty steps; who is stopped drives back. Sonars are read every so many steps,
    not all robots' in the same one; 0: never."""
    for step in range(steps):
        for number, robot in simulation.robots.items():
            stopped = not robot.moving[0]
            if stopped or (step + number) % 20 == 0:
                forward = ((step + number) // 20 + stopped) % 2 == 0
                robot.set_velocities(12.0 if forward else -12.0, 0.5 * sin(step + number), 0.2)
            if look_every and (step + number) % look_every == 0:
                assert len(robot.sonar.readings_in) == 16
        simulation.step(dt_s)
