"""A step of all robots of a figure, in machine code: numba compiles the formulas of the filter.

What stands here is `figure_trial._advance` robot by robot; the formulas are the functions of odometry, sonar_ray and
update that a live filter runs. Results agree with those in arrays to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from math import sqrt
from typing import Any

import numpy as np

from localization.filters import compiled
from localization.filters.belief import HEADING, POSE, Floats, add_outer, unit_vector, wrap_angle
from localization.filters.odometry import OdometryNoise, predict_state, process_variance
from localization.filters.sonar_ray import (
    STRICT,
    RaySonar,
    WallMap,
    intersect_line,
    line_of,
    predict_beam,
    predicted_variance,
    range_variance,
    wall_rows,
)
from localization.filters.update import NONE, kalman_gain, kalman_update
from worlds.compiled import checksum, compile_function
from worlds.raycast import NO_WALL, nearest_wall

Step = Callable[..., None]


def make_step(sources: int) -> Step:
    """Return the loop in Python; the checksum of what it calls is part of its key in numba's cache."""

    def step_robots(
        truth: Floats, mean: Floats, cov: Floats, bound: Floats, nis: Floats, used: Any, steps: Floats,
        motion_error: Floats, sonar_error: Floats, noise: Any, sonar: Any, gate: Any, threshold: float, walls: Any,
        angles_rad: Floats, ring_in: float,
    ) -> None:  # fmt: skip
        """Advance n robots in place: truth, mean (n, 3), cov, bound (n, 3, 3), nis, used (n,), by steps (n, 2)."""
        count = len(angles_rad)
        H, R, innovation = np.zeros((count, POSE)), np.ones(count), np.zeros(count)
        is_used = np.zeros(count, dtype=np.bool_)
        change: Any = np.zeros(POSE)
        H_true: Any = np.zeros(POSE)
        rows = wall_rows(walls)
        listed: Any = compiled.ListedWalls(walls.segments, walls.lines, walls.middle, rows)
        for i in range(len(truth)):
            distance, turn = steps[i, 0], steps[i, 1]
            # 1. The bound along the true path, and the belief, are predicted by the same function.
            predict_state(truth[i].copy(), bound[i], distance, turn, noise)
            predict_state(mean[i], cov[i], distance, turn, noise)
            # 2. The true step has the noise of the model.
            q_distance, q_turn = process_variance(distance, turn, noise)
            true_distance = distance + sqrt(q_distance) * motion_error[i, 0]
            true_turn = turn + sqrt(q_turn) * motion_error[i, 1]
            c, s = unit_vector(truth[i, HEADING] + 0.5 * true_turn)
            truth[i, 0] += true_distance * c
            truth[i, 1] += true_distance * s
            truth[i, HEADING] = wrap_angle(truth[i, HEADING] + true_turn)
            used[i] = 0
            for beam in range(count):
                is_used[beam] = False
                # 3. The true range, the information in it for the bound, and the reading.
                dx, dy = unit_vector(truth[i, HEADING] + angles_rad[beam])
                row = nearest_wall(truth[i, 0], truth[i, 1], dx, dy, rows)[1]
                if row == NO_WALL:
                    continue
                along, slope, _ = intersect_line(truth[i, 0], truth[i, 1], dx, dy, line_of(row, listed), 0.0)
                # An array: `kalman_gain` has code for longer derivatives, which numba refuses for a tuple of three.
                H_true[0], H_true[1], H_true[2] = slope
                R_true = range_variance(sonar, along - ring_in)
                K, S = kalman_gain(bound[i], H_true, R_true)
                add_outer(bound[i], -S, K)
                reading = along - ring_in + sqrt(R_true) * sonar_error[i, beam]
                if not sonar.lowest_in < reading < sonar.highest_in:
                    continue
                # 4. The expected reading, and the chi-square gate; linearised at the mean before the whole ring.
                expected = predict_beam(mean[i], cov[i], angles_rad[beam], ring_in, listed, gate, 0.0)
                if expected.refusal != NONE:
                    continue
                R_beam, error = range_variance(sonar, expected.range_in), reading - expected.range_in
                if error * error <= threshold * (predicted_variance(cov[i], expected.H) + R_beam):
                    innovation[beam], R[beam], is_used[beam] = error, R_beam, True
                    H[beam, 0], H[beam, 1], H[beam, 2] = expected.H
                    used[i] += 1
            # 5. The update by the whole ring, reading by reading, as `ekf.update_ring`.
            change[:], nis[i] = 0.0, 0.0
            for beam in range(count):
                if is_used[beam]:
                    a, b, c = H[beam, 0], H[beam, 1], H[beam, 2]
                    left = innovation[beam] - (a * change[0] + b * change[1] + c * change[2])
                    nis[i] += kalman_update(change, cov[i], H[beam], R[beam], left)
            mean[i] += change
            mean[i, HEADING] = wrap_angle(mean[i, HEADING])
        assert sources >= 0

    return step_robots


@cache
def load_step() -> Step:
    """Return the compiled loop. Raises ImportError without numba."""
    if not compiled.load():
        raise ImportError("numba")
    # numba's cache watches this file only.
    return compile_function(make_step(checksum(*(module.__file__ for module in compiled.SOURCES))))


def bind(
    step: Step, walls: WallMap, noise: OdometryNoise, sonar: RaySonar, angles_rad: Floats, ring_in: float
) -> Step:
    """Return the loop for a trial: a function of its first nine arguments."""
    wall_arrays = compiled.WallArrays(walls.segments, walls.lines, walls.middle)
    return partial(
        step,
        noise=compiled.row_of(compiled.NoiseRow, noise),
        sonar=compiled.row_of(compiled.RaySonarRow, sonar),
        gate=compiled.row_of(compiled.GateRow, STRICT),
        threshold=STRICT.threshold,
        walls=wall_arrays,
        angles_rad=np.ascontiguousarray(angles_rad),
        ring_in=float(ring_in),
    )
