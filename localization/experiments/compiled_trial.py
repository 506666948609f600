"""The runs of a figure in machine code: numba compiles the formulas of the filter and of the control law.

What stands here is `figure_trial._advance` robot by robot and step by step; the formulas are the functions of odometry,
sonar_ray, update and control_law that a live robot runs. Results agree with those in arrays to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import cache
from math import sqrt
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from localization.filters import compiled
from localization.filters.belief import HEADING, POSE, Floats, add_outer, hypot, unit_vector, wrap_angle
from localization.filters.odometry import predict_state, process_variance
from localization.filters.sonar_ray import (
    STRICT,
    intersect_line,
    line_of,
    predict_beam,
    predicted_variance,
    range_variance,
    wall_rows,
)
from localization.filters.update import NONE, apply_gain, pose_gain
from localization.navigation import control_law
from localization.navigation.control_law import ControlGains, step_to
from worlds.compiled import checksum, compile_function, make_compilable
from worlds.raycast import NO_WALL, nearest_wall

if TYPE_CHECKING:
    from localization.experiments.figure_trial import FigureSetup

Drive = Callable[..., None]

GainsRow = NamedTuple("GainsRow", [(field.name, float) for field in fields(ControlGains)])  # type: ignore[misc]


class Trial(NamedTuple):
    """A `FigureSetup` as compiled code takes it."""

    goals_in: Floats
    waypoint_radius_in: float
    gains: Any
    noise: Any
    sonar: Any
    gate: Any
    threshold: float
    walls: Any
    angles_rad: Floats
    ring_in: float


class Robots(NamedTuple):
    """n robots: truth, mean (n, 3), cov, bound (n, 3, 3), leg and steps so far (n,), as in `figure_trial.Batch`."""

    truth: Floats
    mean: Floats
    cov: Floats
    bound: Floats
    leg: Any
    steps: Any


class History(NamedTuple):
    """State of n robots after each of T steps, as in `figure_trial.Runs`: (T, n, ...)."""

    truth: Floats
    mean: Floats
    cov: Floats
    bound: Floats
    nis: Floats
    used: Any


def make_drive(sources: int) -> Drive:
    """Return the loop in Python; the checksum of what it calls is part of its key in numba's cache."""

    def drive_robots(
        robots: Any, history: Any, motion_error: Floats, sonar_error: Floats, is_moving: Any, trial: Any
    ) -> None:
        """Drive n robots for k steps, in place, or to their last goals.

        Parameters
        ----------
        motion_error, sonar_error
            Standard normals (k, n, 2) and (k, n, beams).
        is_moving
            (n,), overwritten: True for each that has a goal left and a row left in the history.
        """
        truth, mean, cov, bound, leg, steps = robots
        goals, noise, sonar, gate, walls, angles_rad = (
            trial.goals_in, trial.noise, trial.sonar, trial.gate, trial.walls, trial.angles_rad,
        )  # fmt: skip
        count = len(angles_rad)
        H, R, innovation = np.zeros((count, POSE)), np.ones(count), np.zeros(count)
        is_used = np.zeros(count, dtype=np.bool_)
        change: Any = np.zeros(POSE)
        before: Any = np.zeros(POSE)
        rows = wall_rows(walls)
        listed: Any = compiled.ListedWalls(walls.segments, walls.lines, walls.middle, rows)
        for i in range(len(truth)):
            x, P = mean[i], cov[i]
            for k in range(len(motion_error)):
                row, goal = steps[i], leg[i]
                is_moving[i] = goal < len(goals) and row < len(history.nis)
                if not is_moving[i]:
                    break
                # 1. The command.
                distance, turn = step_to(x[0], x[1], x[HEADING], goals[goal, 0], goals[goal, 1], trial.gains)
                # 2. The bound along the true path, and the belief, are predicted by the same function.
                before[:] = truth[i]
                predict_state(before, bound[i], distance, turn, noise)
                predict_state(x, P, distance, turn, noise)
                # 3. The true step has the noise of the model.
                q_distance, q_turn = process_variance(distance, turn, noise)
                true_distance = distance + sqrt(q_distance) * motion_error[k, i, 0]
                true_turn = turn + sqrt(q_turn) * motion_error[k, i, 1]
                c, s = unit_vector(truth[i, HEADING] + 0.5 * true_turn)
                truth[i, 0] += true_distance * c
                truth[i, 1] += true_distance * s
                truth[i, HEADING] = wrap_angle(truth[i, HEADING] + true_turn)
                used = 0
                for beam in range(count):
                    is_used[beam] = False
                    # 4. The true range, the information in it for the bound, and the reading.
                    dx, dy = unit_vector(truth[i, HEADING] + angles_rad[beam])
                    wall = nearest_wall(truth[i, 0], truth[i, 1], dx, dy, rows)[1]
                    if wall == NO_WALL:
                        continue
                    along, slope, _ = intersect_line(truth[i, 0], truth[i, 1], dx, dy, line_of(wall, listed), 0.0)
                    R_true = range_variance(sonar, along - trial.ring_in)
                    K, S = pose_gain(bound[i], slope, R_true)
                    add_outer(bound[i], -S, K)
                    reading = along - trial.ring_in + sqrt(R_true) * sonar_error[k, i, beam]
                    if not sonar.lowest_in < reading < sonar.highest_in:
                        continue
                    # 5. The expected reading, and the chi-square gate; linearised at the mean before the whole ring.
                    expected = predict_beam(x, P, angles_rad[beam], trial.ring_in, listed, gate, 0.0)
                    if expected.refusal != NONE:
                        continue
                    R_beam, error = range_variance(sonar, expected.range_in), reading - expected.range_in
                    if error * error <= trial.threshold * (predicted_variance(P, expected.H) + R_beam):
                        innovation[beam], R[beam], is_used[beam] = error, R_beam, True
                        H[beam, 0], H[beam, 1], H[beam, 2] = expected.H
                        used += 1
                # 6. The update by the whole ring, reading by reading, as `ekf.update_ring`.
                nis = 0.0
                change[:] = 0.0
                for beam in range(count):
                    if is_used[beam]:
                        a, b, c = H[beam, 0], H[beam, 1], H[beam, 2]
                        left = innovation[beam] - (a * change[0] + b * change[1] + c * change[2])
                        K, S = pose_gain(P, (a, b, c), R[beam])
                        nis += apply_gain(change, P, K, S, left)
                x[0] += change[0]
                x[1] += change[1]
                x[HEADING] = wrap_angle(x[HEADING] + change[HEADING])
                # 7. The step is over; a goal may be reached.
                history.truth[row, i], history.mean[row, i] = truth[i], x
                history.cov[row, i], history.bound[row, i] = P, bound[i]
                history.nis[row, i], history.used[row, i] = nis, used
                steps[i] = row + 1
                if hypot(goals[goal, 0] - x[0], goals[goal, 1] - x[1]) <= trial.waypoint_radius_in:
                    leg[i] = goal + 1
        assert sources >= 0

    return drive_robots


@cache
def load_drive() -> Drive:
    """Return the compiled loop. Raises ImportError without numba."""
    compiled.load()
    make_compilable([step_to])
    sources = checksum(__file__, control_law.__file__, *(module.__file__ for module in compiled.SOURCES))
    # A division by zero gives what it gives in arrays.
    return cast("Drive", compile_function(make_drive(sources), is_division_tested=False))


def trial_of(setup: FigureSetup) -> Trial:
    """Return a configuration as compiled code takes it."""
    return Trial(
        goals_in=np.ascontiguousarray(setup.goals_in, dtype=np.float64),
        waypoint_radius_in=float(setup.waypoint_radius_in),
        gains=compiled.row_of(GainsRow, setup.gains),
        noise=compiled.row_of(compiled.NoiseRow, setup.noise),
        sonar=compiled.row_of(compiled.RaySonarRow, setup.sonar),
        gate=compiled.row_of(compiled.GateRow, STRICT),
        threshold=STRICT.threshold,
        walls=compiled.WallArrays(setup.walls.segments, setup.walls.lines, setup.walls.middle),
        angles_rad=np.ascontiguousarray(setup.angles_rad),
        ring_in=float(setup.body.sonar_ring_radius_in),
    )
