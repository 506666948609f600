"""Drives in a room by a simulation of its own: cones in a few lines, independent of the emulator and the filters."""

from __future__ import annotations

from itertools import pairwise
from math import atan2, cos, hypot, pi, radians, sin

import numpy as np

from localization.filters.belief import Floats
from localization.mapping.measurements import DriveLog
from worlds.robots import N150

ROOM = ((0.0, 0.0), (120.0, 0.0), (120.0, 100.0), (0.0, 100.0))
LAP = ((25.0, 25.0), (95.0, 25.0), (95.0, 75.0), (25.0, 75.0), (25.0, 30.0))
HALF_CONE = radians(12.5)
SPEED_IN_S, TURN_RAD_S, STEP_S, FIRING_S = 5.0, 0.5, 0.1, 0.06


def true_path(points: tuple[tuple[float, float], ...] = LAP) -> Floats:
    """Return rows of time, x, y, heading every STEP_S: straight legs, turns in place."""
    (x, y), heading, clock = points[0], 0.0, 0.0
    rows = [(clock, x, y, heading)]
    for goal_x, goal_y in points[1:]:
        turn = (atan2(goal_y - y, goal_x - x) - heading + pi) % (2.0 * pi) - pi
        steps = max(int(abs(turn) / TURN_RAD_S / STEP_S), 1)
        for _ in range(steps):
            heading, clock = heading + turn / steps, clock + STEP_S
            rows.append((clock, x, y, heading))
        away = hypot(goal_x - x, goal_y - y)
        steps = max(int(away / SPEED_IN_S / STEP_S), 1)
        for _ in range(steps):
            x, y, clock = x + away / steps * cos(heading), y + away / steps * sin(heading), clock + STEP_S
            rows.append((clock, x, y, heading))
    return np.array(rows)


def echo(x: float, y: float, axis: float, *outlines: tuple[tuple[float, float], ...]) -> float:
    """Return the distance to the nearest wall or corner within the cone of a sonar, 255 if none; convex outlines."""
    found = [255.0]
    sides = [side for corners in outlines or (ROOM,) for side in zip(corners, corners[1:] + corners[:1], strict=True)]
    for (x1, y1), (x2, y2) in sides:
        length = hypot(x2 - x1, y2 - y1)
        along_x, along_y = (x2 - x1) / length, (y2 - y1) / length
        foot = (x - x1) * along_x + (y - y1) * along_y
        spots = [(x1, y1)]
        if 0.0 < foot < length:
            spots.append((x1 + foot * along_x, y1 + foot * along_y))
        for spot_x, spot_y in spots:
            off = (atan2(spot_y - y, spot_x - x) - axis + pi) % (2.0 * pi) - pi
            if abs(off) <= HALF_CONE:
                found.append(hypot(spot_x - x, spot_y - y))
    return min(found)


def ray(x: float, y: float, axis: float, *outlines: tuple[tuple[float, float], ...]) -> float:
    """Return the distance along the axis of a sonar to the nearest wall, 255 if none; outlines."""
    found = [255.0]
    sides = [side for corners in outlines or (ROOM,) for side in zip(corners, corners[1:] + corners[:1], strict=True)]
    for (x1, y1), (x2, y2) in sides:
        # (x, y) + distance (cos, sin) = (x1, y1) + fraction (x2 - x1, y2 - y1), by Cramer's rule.
        along_x, along_y = x2 - x1, y2 - y1
        slope = along_x * sin(axis) - along_y * cos(axis)
        if slope == 0.0:
            continue
        distance = (along_x * (y1 - y) - along_y * (x1 - x)) / slope
        fraction = (cos(axis) * (y1 - y) - sin(axis) * (x1 - x)) / slope
        if distance > 0.0 and 0.0 <= fraction <= 1.0:
            found.append(distance)
    return min(found)


def drive(seed: int = 0, *, quiet: bool = False, scale: float = 1.0, offsets_in: Floats | None = None,
          outlines: tuple[tuple[tuple[float, float], ...], ...] = (ROOM,),
          points: tuple[tuple[float, float], ...] = LAP, rays: bool = False) -> DriveLog:  # fmt: skip
    """Return a lap with the random errors of `--odometry-noise 0.05,0.05,0.002`, or without any; by cones or rays."""
    rng = np.random.default_rng(seed)
    path = true_path(points)
    # 1. Encoders: the true steps with noise, integrated from another origin.
    x, y, heading = -3.0, 7.0, 0.4
    rows = [(0.0, x, y, heading, heading)]
    for before, after in pairwise(path):
        distance, turn = float(np.hypot(*(after[1:3] - before[1:3]))), after[3] - before[3]
        if not quiet:
            turn += rng.normal(0.0, (0.05**2 * abs(turn) + 0.002**2 * distance) ** 0.5)
            distance += rng.normal(0.0, 0.05 * distance**0.5)
        distance /= scale
        x += distance * cos(heading + 0.5 * turn)
        y += distance * sin(heading + 0.5 * turn)
        heading += turn
        rows.append((after[0], x, y, heading, heading))
    # 2. Sonars one after the other, at the true poses.
    order = [0, 2, 15, 1, 14, 3, 13, 4, 12, 5, 11, 6, 10, 7, 9, 8]
    instants = np.arange(0.01, path[-1, 0], FIRING_S)
    poses = np.stack([np.interp(instants, path[:, 0], path[:, column]) for column in (1, 2, 3)], axis=-1)
    sonars = np.array([order[k % 16] for k in range(len(instants))])
    readings = []
    for (x, y, heading), sonar in zip(poses.tolist(), sonars.tolist(), strict=True):
        axis = heading + N150.sonar_angles_rad[sonar]
        ring = N150.sonar_ring_radius_in
        found = (ray if rays else echo)(x + ring * cos(axis), y + ring * sin(axis), axis, *outlines)
        if found < 255.0:
            found += 0.0 if offsets_in is None else offsets_in[sonar]
            found += 0.0 if quiet else rng.normal(0.0, 0.01 * found)
            found = found if quiet else float(round(found))
        readings.append(found)
    return DriveLog(
        np.array(rows), instants, sonars, np.array(readings), np.asarray(N150.sonar_angles_rad),
        N150.sonar_ring_radius_in,
    )  # fmt: skip
