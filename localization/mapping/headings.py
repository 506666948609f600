"""Headings after turns, and the poses of a stretch of a drive in a map.

After a turn the heading is uncertain by several degrees, more than the nearest reflector allows. So several headings
are compared before the echoes that follow are assigned.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from localization.filters.belief import HEADING, Floats, rotate
from localization.filters.odometry import OdometryNoise, process_variance
from localization.mapping.association import MapEstimate, assign
from localization.mapping.measurements import Indices, Trajectory
from localization.mapping.problem import NO_FEATURE, Assignment, Sensors, sensors_at

TURN_STEP_RAD: Final = 0.05
"""A robot that turns less between two nodes drives straight."""
MIN_TURN_RAD, MAX_TURN_RAD = 0.2, 1.0
LAG_NODES: Final = 20
"""Nodes that are tracked together: 10 s."""
ALIGN_NODES: Final = 6
"""Of a stretch that is tracked: a turn that ended longer ago has its heading."""
HEADINGS: Final = np.linspace(-3.0, 3.0, 25)
"""Compared headings, in standard deviations of the turn."""


def find_turns(steps: Floats, first: int) -> list[tuple[int, float]]:
    """Return the turns from a step on: the node at which each ends, and by how much the robot turned, radians."""
    turns, total = [], 0.0
    for number in range(max(first, 0), len(steps)):
        turn = float(steps[number, HEADING])
        is_turning = abs(turn) > TURN_STEP_RAD
        total += abs(turn) if is_turning else 0.0
        # A robot that circles never ends its turn.
        if total > MAX_TURN_RAD or (total and (not is_turning or number == len(steps) - 1)):
            turns.append((number + int(is_turning), total))
            total = 0.0
    return [(node, total) for node, total in turns if total > MIN_TURN_RAD]


def align_heading(estimate: MapEstimate, first_node: int, noise: OdometryNoise) -> None:
    """Rotate what follows each turn since a node to the heading that explains its echoes best.

    Each heading is rated by the cost of the echoes since the turn and by the odometry; the best one and the present
    one are both optimized, and the cheaper is the result.
    """
    problem, state = estimate.problem, estimate.state
    if not state.features:
        return
    count = len(state.poses)
    for node, turn in find_turns(problem.trajectory.steps[: count - 1], first_node):
        std = process_variance(0.0, turn, noise)[1] ** 0.5
        echoes = estimate.echoes(node)
        if len(echoes) < 8:
            continue
        # All headings at once.
        sensors = _turned_sensors(estimate, node, echoes, HEADINGS * std)
        _, cost = assign(estimate, np.tile(echoes, len(HEADINGS)), sensors)
        costs = cost.reshape(len(HEADINGS), -1).sum(axis=1) + np.square(HEADINGS)
        best = int(np.argmin(costs))
        present = len(HEADINGS) // 2
        if costs[best] > costs[present] - 2.0:
            continue
        # Both, optimized: the one that is cheaper then.
        other = estimate.copy()
        other.state = replace(other.state, poses=_turned(other.state.poses, node, HEADINGS[best] * std))
        for candidate in (other, estimate):
            candidate.associate(max(first_node, node - 1))
            candidate.optimize()
        if other.cost < estimate.cost:
            estimate.replace_by(other)


def track(estimate: MapEstimate, trajectory: Trajectory, poses: Floats, noise: OdometryNoise) -> MapEstimate:
    """Return the poses of a stretch of a drive in a map that stays as it is.

    Parameters
    ----------
    estimate
        The map.
    trajectory
        The stretch.
    poses
        (k, 3) known poses of its first nodes, of which the first one stays; the others follow by the odometry.
    noise
        Random errors of the odometry.
    """
    problem = estimate.problem.with_trajectory(trajectory, has_fixed_map=True)
    nothing = Assignment(np.full(len(trajectory.node), NO_FEATURE, dtype=np.intp))
    state = replace(estimate.state, poses=poses)
    found = MapEstimate(problem, state, nothing, estimate.extents, estimate.runs, estimate.sides)
    found.extend(len(trajectory))
    if state.features and len(trajectory) > 1:
        align_heading(found, len(trajectory) - ALIGN_NODES, noise)
        found.associate()
        found.optimize(2)
    return found


def _turned_sensors(estimate: MapEstimate, node: int, echoes: Indices, angles_rad: Floats) -> Sensors:
    """Return the sonars (k e,) at echoes from a node on, with what follows it rotated about it by each of k angles."""
    state = estimate.state
    sensors = sensors_at(state.poses, state.parameters, estimate.problem.trajectory, echoes)
    angles = np.repeat(angles_rad, len(echoes))
    count, centre = len(angles_rad), state.poses[node, :2]
    return Sensors(
        centre + rotate(np.tile(sensors.face - centre, (count, 1)), angles),
        rotate(np.tile(sensors.arm, (count, 1)), angles),
        np.tile(sensors.axis, count) + angles, np.tile(sensors.range_in, count),
    )  # fmt: skip


def _turned(poses: Floats, node: int, angle_rad: float) -> Floats:
    """Return the trajectory with all poses from a node on rotated about it."""
    turned = poses.copy()
    turned[node:, :2] = poses[node, :2] + rotate(
        poses[node:, :2] - poses[node, :2], np.full(len(poses) - node, angle_rad)
    )
    turned[node:, HEADING] += angle_rad
    return turned
