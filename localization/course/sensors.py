"""Checks of notebooks 01 to 03, 10 and 11: odometry, sonars, a wall follower; calibration, maps."""

from __future__ import annotations

from math import atan2, cos, degrees, hypot, inf, isinf, pi, radians, sin, sqrt

import numpy as np

from localization.course.tasks import TRIES, Answer, Rng, Wrong, expect, numbers, require, task, truth_value
from worlds.raycast import cast_ray

RING_IN = 9.06
"""Distance of the sonars from the axis of a Nomad."""
SPACING_RAD = pi / 8
SIDE, AHEAD_SIDE = -4 * SPACING_RAD, -3 * SPACING_RAD
"""Directions of the sonars 12 and 13."""


def drive_arc(pose: tuple[float, float, float], distance_in: float, turn_rad: float) -> tuple[float, float, float]:
    """Return the pose after an arc, by many short steps."""
    x, y, heading = pose
    steps = 400
    for k in range(steps):
        angle = heading + (k + 0.5) / steps * turn_rad
        x, y = x + distance_in / steps * cos(angle), y + distance_in / steps * sin(angle)
    return x, y, heading + turn_rad


def _step(rng: Rng) -> tuple[tuple[float, float, float], float, float]:
    """Return a pose, a distance and a turn, either of them positive or negative."""
    x, y, heading = rng.uniform((-50, -50, 0), (50, 50, 2 * pi)).tolist()
    distance_in, turn_rad = (rng.uniform((1, 0.1), (4, 0.3)) * rng.choice((-1, 1), 2)).tolist()
    return (x, y, heading), distance_in, turn_rad


@task("01", points=2)
def step_pose(answer: Answer, rng: Rng) -> None:
    """Check the pose after a step of the encoders."""
    for _ in range(TRIES):
        pose, distance, turn = _step(rng)
        x, y, heading = pose
        mistakes = [
            ((x + distance * cos(heading), y + distance * sin(heading), heading + turn),
             "While driving, the heading is on average that at half of the turn, not that at the beginning."),
            ((x + distance * cos(heading + turn), y + distance * sin(heading + turn), heading + turn),
             "While driving, the heading is on average that at half of the turn, not that at the end."),
            ((*drive_arc(pose, distance, turn)[:2], heading), "The heading changes by the turn as well."),
            ((*drive_arc(pose, distance, turn)[:2], heading - turn), "A turn to the left is positive."),
            ((x - distance * sin(heading + turn / 2), y + distance * cos(heading + turn / 2), heading + turn),
             "Heading 0 is along x: x changes by the cosine, y by the sine."),
        ]
        expect(answer, (pose, distance, turn), drive_arc(pose, distance, turn), (0.02, 0.02, 1e-6), angles=(2,),
               mistakes=mistakes, hint="Are cosine and sine taken of radians?")  # fmt: skip


@task("01", points=2)
def relative_step(answer: Answer, rng: Rng) -> None:
    """Check distance and turn between two poses of the encoders, whose headings are in [0, 2 pi)."""
    for k in range(TRIES):
        before, distance, turn = _step(rng)
        # Every other step crosses heading 0.
        if k % 2:
            before = (*before[:2], (-turn / 2) % (2 * pi))
        x, y, heading = drive_arc(before, distance, turn)
        after = (x, y, heading % (2 * pi))
        unwrapped = after[2] - before[2]
        mistakes = [
            ((distance, unwrapped), "Headings are in [0, 2 pi): bring the difference into (-pi, pi]."),
            ((abs(distance), turn), "Backwards the distance is negative: project the displacement on the heading."),
            ((abs(distance), unwrapped), "Backwards the distance is negative, and the turn is in (-pi, pi]."),
            ((distance, -turn), "The turn is the heading after minus the heading before."),
        ]
        expect(answer, (before, after), (distance, turn), (0.05, 1e-6), mistakes=mistakes,
               hint="Return the distance along the heading and the turn.")  # fmt: skip


@task("01")
def random_error(answer: Answer, rng: Rng) -> None:
    """Check the variance per inch of distance errors."""
    alpha = rng.uniform(0.005, 0.05)
    distances = rng.uniform(10, 100, 3000)
    errors = rng.normal(0, np.sqrt(alpha * distances))
    mistakes = [
        (sqrt(alpha), "That is a standard deviation; the variance is its square."),
        (np.mean(errors**2), "That is the variance at the mean distance; divide by the distance."),
        (np.mean(np.abs(errors) / distances), "Variances grow with the distance, not errors: square the errors."),
        (np.mean(errors / distances), "Errors of both signs cancel: square them first."),
    ]
    expect(answer, (distances, errors), alpha, 0.15 * alpha, mistakes=mistakes,
           hint="The mean of error squared is alpha times the distance.")  # fmt: skip


@task("02")
def sonar_direction(answer: Answer, rng: Rng) -> None:
    """Check the direction of a sonar in the room."""
    for number in (0, 1, 4, 12, 15, *rng.integers(0, 16, 4).tolist()):
        turret = rng.uniform(0, 2 * pi)
        right = turret + number * SPACING_RAD
        mistakes = [
            (turret - number * SPACING_RAD, "Sonars are numbered counter-clockwise, as angles are."),
            (number * SPACING_RAD, "The ring turns with the turret."),
            (turret + number * 22.5, "22.5 degrees are pi / 8 radians."),
            (degrees(right), "Radians, please."),
        ]
        expect(answer, (turret, number), right, 1e-3, angles=(0,), mistakes=mistakes)


@task("02")
def echo_point(answer: Answer, rng: Rng) -> None:
    """Check the place in the room at which a sonar points."""
    for _ in range(TRIES):
        x, y, turret = rng.uniform((-50, -50, 0), (50, 50, 2 * pi)).tolist()
        number, reading = int(rng.integers(0, 16)), float(rng.integers(7, 120))
        u = np.array([cos(turret + number * SPACING_RAD), sin(turret + number * SPACING_RAD)])
        left = np.array([cos(turret - number * SPACING_RAD), sin(turret - number * SPACING_RAD)])
        mistakes = [
            ((x, y) + reading * u, f"A range begins at the sonar, {RING_IN} in from the axis."),
            ((x, y) + (RING_IN + reading) * left, "Sonars are numbered counter-clockwise."),
            ((RING_IN + reading) * u, "Add the position of the robot."),
        ]
        expect(answer, (x, y, turret, number, reading), (x, y) + (RING_IN + reading) * u, 0.1, mistakes=mistakes,
               hint="Start at the axis and go along the direction of the sonar.")  # fmt: skip


@task("02", points=2)
def range_to_wall(answer: Answer, rng: Rng) -> None:
    """Check the range along a ray to a wall, infinite where it misses."""
    hits = misses = 0
    while min(hits, misses) < TRIES:
        x, y, direction = rng.uniform((-40, -40, 0), (40, 40, 2 * pi)).tolist()
        wall = tuple(rng.uniform(-60, 60, 4).tolist())
        # Every third wall that is met is parallel to the y axis.
        if hits % 3 == 0:
            wall = (wall[0], wall[1], wall[0], wall[3])
        ranges = [
            cast_ray(x, y, cos(direction + off), sin(direction + off), np.array([wall]))[0]
            for off in (-0.03, 0.0, 0.03)
        ]
        # Rays that pass an end of the wall closely are left out: rounding would decide.
        if len({isinf(each) for each in ranges}) > 1 or not (isinf(ranges[1]) or 1 < ranges[1] < 200):
            continue
        right = ranges[1]
        hits, misses = hits + (not isinf(right)), misses + isinf(right)
        if isinf(right):
            found = float(numbers(answer, x, y, direction, wall, shape=()))
            backwards = cast_ray(x, y, -cos(direction), -sin(direction), np.array([wall]))[0]
            hint = "It lies behind the sonar." if not isinf(backwards) else "The ray passes its end."
            require(found > 1e6, f"The ray from ({x:.1f}, {y:.1f}) in the direction {direction:.3f} does not meet the "
                                 f"wall {np.round(wall, 1).tolist()}; expected math.inf, not {found:.4g}. {hint}")
        else:
            middle = hypot(x - (wall[0] + wall[2]) / 2, y - (wall[1] + wall[3]) / 2)
            mistakes = [
                (inf, "The ray meets this wall. Are walls parallel to an axis handled?"),
                (-right, "Ahead of the sonar a range is positive."),
                (middle, "That is the distance to its middle."),
            ]
            expect(answer, (x, y, direction, wall), right, 0.01, mistakes=mistakes)


@task("02")
def reading_std(answer: Answer, rng: Rng) -> None:
    """Check the standard deviation of a reading in whole inches with a noise of one per cent."""
    for _ in range(4):
        range_in = float(rng.uniform(15, 120))
        # By experiment: random noise, then rounding.
        true = range_in + rng.uniform(-0.5, 0.5, 60_000)
        right = float(np.std(np.round(true + 0.01 * range_in * rng.standard_normal(60_000)) - true))
        mistakes = [
            (0.01 * range_in, "Rounding to whole inches adds an error, too: uniform over an inch."),
            (sqrt(1 / 12), "The noise of one per cent comes on top of the rounding."),
            (0.01 * range_in + sqrt(1 / 12), "Independent errors add as variances, not as standard deviations."),
            (right**2, "That is the variance; take its root."),
            (hypot(0.01 * range_in, 0.5), "A uniform error over an inch has the variance 1/12."),
            (hypot(0.01 * range_in, 1.0), "A uniform error over an inch has the variance 1/12."),
        ]
        expect(answer, (range_in,), right, 0.03 * right, mistakes=mistakes)


@task("03", points=2)
def wall_on_the_right(answer: Answer, rng: Rng) -> None:
    """Check distance and direction of a wall, from the sonars 12 and 13."""
    for _ in range(TRIES):
        distance, angle = float(rng.uniform(15, 40)), float(rng.uniform(-0.4, 0.4))
        # A long wall at this distance from the origin, to the right of a robot that looks along x.
        foot, along = np.array([sin(angle), -cos(angle)]) * distance, np.array([cos(angle), sin(angle)])
        wall = np.array([[*(foot - 500 * along), *(foot + 500 * along)]])
        side, ahead = (cast_ray(0, 0, cos(at), sin(at), wall)[0] - RING_IN for at in (SIDE, AHEAD_SIDE))
        bare = ahead * np.array([cos(AHEAD_SIDE), sin(AHEAD_SIDE)]) - side * np.array([0.0, -1.0])
        bare_angle = atan2(bare[1], bare[0])
        mistakes = [
            ((side * cos(bare_angle), bare_angle), f"Ranges begin {RING_IN} in from the axis."),
            ((side + RING_IN, angle), "The shortest line to the wall is perpendicular to the wall, not to the robot."),
            ((distance, -angle), "The angle is positive if the wall turns to the left, into the robot's path."),
            ((distance - RING_IN, angle), "The distance is from the axis."),
            ((distance, degrees(angle)), "Radians, please."),
        ]
        expect(answer, (side, ahead), (distance, angle), (0.05, 0.005), mistakes=mistakes,
               hint="Two points of the wall give its direction.")  # fmt: skip


@task("03", points=2)
def turn_rate(answer: Answer, rng: Rng) -> None:
    """Check a control law by driving along a simulated wall."""
    wanted = 20.0
    at_goal = float(numbers(answer, wanted, 0.0, wanted, shape=()))
    require(abs(at_goal) < 1.0, f"At the wanted distance and parallel to the wall it turns by {at_goal:.3g} deg/s.")
    for near in (8.0, 50.0):
        rate = float(numbers(answer, near, 0.0, wanted, shape=()))
        require(abs(rate) <= 30.0 + 1e-9, f"{near:.0f} in from the wall it turns by {rate:.3g} deg/s: limit it to ±30.")
        require(rate * (wanted - near) > 0.0, f"{near:.0f} in from the wall, {wanted:.0f} wanted, it turns by "
                f"{rate:.3g} deg/s. The wall is on the right; a turn to the left is positive.")  # fmt: skip
    for begin in rng.uniform(12, 32, 4).tolist():
        distance, angle = begin, 0.0
        for _ in range(300):
            rate = float(numbers(answer, distance, angle, wanted, shape=()))
            require(abs(rate) <= 30.0 + 1e-9, f"The turn rate is {rate:.3g} deg/s: limit it to ±30.")
            # 0.1 s at 6 in/s; the robot's heading against the wall is minus the wall's angle.
            angle -= 0.1 * radians(rate)
            distance -= 0.6 * sin(angle)
            require(distance > 10.0, f"From {begin:.1f} in it runs into the wall: use the angle as well.")
        require(
            abs(distance - wanted) < 1.0 and abs(angle) < 0.1,
            f"From {begin:.1f} in it is {distance:.1f} in from the wall after 30 s at 6 in/s, not {wanted:.0f}, at "
            f"{degrees(angle):.0f} deg. Oscillating? Add a term with the angle, as a damper; slow? Increase the gains.",
        )


@task("03")
def is_blocked(answer: Answer, rng: Rng) -> None:
    """Check whether something is near ahead."""
    for number in (15, 0, 1, 4, 8, 12, None):
        sonars = rng.integers(40, 255, 16).tolist()
        limit = float(rng.integers(15, 30))
        if number is not None:
            sonars[number] = int(limit) - int(rng.integers(2, 8))
        right = number in (15, 0, 1)
        found = truth_value(answer, sonars, limit)
        where = "all sonars" if number is None else f"sonar {number} at {sonars[number]} in and all others"
        require(found is right, f"With {where} at 40 in or more, limit {limit:.0f} in, it returned {found}. "
                                "Ahead are the sonars 15, 0 and 1.")  # fmt: skip


HALF_CONE_RAD = radians(12.5)
THICK_IN, P_FREE, P_OCCUPIED = 4.0, 0.35, 0.7
"""The sensor model of notebook 11: depth of an arc, probabilities of being occupied before and in it."""


@task("10")
def fit_scale(answer: Answer, rng: Rng) -> None:
    """Check the true distance per counted distance."""
    for _ in range(3):
        scale = float(rng.choice((-1, 1)) * rng.uniform(0.02, 0.06) + 1)
        counted = rng.uniform(30, 100, 40)
        measured = scale * counted + rng.normal(0, 0.1, 40)
        mistakes = [
            (1 / scale, "True inches per counted inch: measured is the scale times counted."),
            (scale - 1, "That is the error; the scale is near 1."),
            (np.mean(measured - counted), "The error grows with the distance: a factor, not a difference."),
        ]
        expect(answer, (counted, measured), scale, 0.003, mistakes=mistakes,
               hint="Minimize the squares of measured - scale * counted.")  # fmt: skip


def _drives(rng: Rng, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Return counted distances and turns of drives with some of both."""
    return rng.uniform(20, 120, count), rng.uniform(-2 * pi, 2 * pi, count)


@task("10", points=2)
def fit_turn_and_drift(answer: Answer, rng: Rng) -> None:
    """Check the turn scale and the drift."""
    for _ in range(3):
        distances, turns = _drives(rng)
        scale, drift = float(rng.uniform(0.94, 0.98)), float(rng.choice((-1, 1)) * rng.uniform(0.0008, 0.002))
        true = scale * turns + drift * distances + rng.normal(0, 0.003, len(turns))
        mistakes = [
            ((drift, scale), "Return the scale first, then the drift."),
            ((scale, -drift), "The drift is the turn to the left per inch: mind the sign."),
            ((1 / scale, drift), "True turn per counted turn."),
            ((true @ turns / (turns @ turns), 0.0), "Driving straight turns the robot, too: the drift is not 0."),
        ]
        expect(answer, (distances, turns, true), (scale, drift), (0.003, 1e-4), mistakes=mistakes,
               hint="Two unknowns: true = scale * turns + drift * distances. np.linalg.lstsq solves it.")  # fmt: skip


@task("10", points=2)
def fit_std(answer: Answer, rng: Rng) -> None:
    """Check the standard deviations of turn scale and drift, against many simulated fits."""
    distances, turns = _drives(rng, 20)
    sigma = float(rng.uniform(0.01, 0.05))
    A = np.column_stack((turns, distances))
    many = sigma * rng.standard_normal((20, 4000))
    right = np.linalg.lstsq(A, many, rcond=None)[0].std(axis=1)
    information = A.T @ A
    mistakes = [
        (right**2, "These are variances: take the roots."),
        (right / sigma, "Multiply by the noise, sigma."),
        (right / sqrt(sigma), "The covariance is sigma squared times the inverse of A' A."),
        (sigma / np.sqrt(np.diag(information)),
         "Invert the matrix, then take its diagonal: the unknowns are correlated."),
        (right[::-1], "The scale first, then the drift."),
        (sigma * np.sqrt(np.diag(information)), "More data makes the result more certain: the inverse of A' A."),
    ]
    expect(answer, (distances, turns, sigma), right, 0.06 * right, mistakes=mistakes,
           hint="P = sigma^2 inv(A' A), with the columns turns and distances of A.")  # fmt: skip


@task("10")
def sonar_offset(answer: Answer, rng: Rng) -> None:
    """Check the constant error of a sonar among outliers."""
    for _ in range(3):
        offset = float(rng.choice((-1, 1)) * rng.uniform(1, 2))
        ranges = rng.uniform(20, 90, 200)
        readings = np.round(ranges + offset + rng.normal(0, 0.3, 200))
        # Second echoes are longer, missing ones 255.
        readings[::10] = np.round(ranges[::10] * 2 + 9)
        readings[5::20] = 255.0
        errors = readings - ranges
        mistakes = [
            (-np.median(errors), "The offset is the reading minus the range."),
            (errors.mean(), "The mean follows outliers: second echoes, and 255 where there was none. Try the median."),
            (errors[readings < 255].mean(), "255 is left out; second echoes are left, and the mean follows them."),
        ]
        expect(answer, (readings, ranges), offset, 0.25, mistakes=mistakes)


@task("11")
def update_cell(answer: Answer, rng: Rng) -> None:
    """Check log odds after a reading, against Bayes' rule in probabilities."""
    for _ in range(TRIES):
        before, p = rng.normal(0, 2, 4), rng.uniform(0.1, 0.9, 4)
        prior = 1 / (1 + np.exp(-before))
        posterior = prior * p / (prior * p + (1 - prior) * (1 - p))
        mistakes = [
            (posterior, "That is a probability; return its log odds."),
            (before + p, "Add the log odds of p, not p."),
            (before + np.log(p), "The log odds of p are log(p / (1 - p))."),
            (before - np.log(p / (1 - p)), "The sign: p above 1/2 raises the log odds."),
            (np.log(p / (1 - p)), "Add to the log odds before."),
            (before + np.log10(p / (1 - p)), "The natural logarithm, please."),
        ]
        expect(answer, (before, p), np.log(posterior / (1 - posterior)), 1e-6, mistakes=mistakes)


@task("11", points=2)
def inverse_sensor(answer: Answer, rng: Rng) -> None:
    """Check the probability of cells, given one reading."""
    for reading in (*rng.integers(20, 100, 6).tolist(), 255):
        distances, angles = rng.uniform(5, 120, 60), rng.uniform(-0.5, 0.5, 60)
        gap, half = distances - reading, THICK_IN / 2
        # Cells at a border may count for either side.
        clear = (np.abs(np.abs(gap) - half) > 0.2) & (np.abs(np.abs(angles) - HALF_CONE_RAD) > 0.01)
        distances, angles, gap = distances[clear], angles[clear], gap[clear]
        inside = np.abs(angles) < HALF_CONE_RAD
        right = np.where(inside & (gap < -half), P_FREE, 0.5)
        right[inside & (np.abs(gap) <= half)] = P_OCCUPIED
        if reading == 255:
            right[:] = 0.5
        found = numbers(answer, distances, angles, float(reading), shape=distances.shape)
        wrong = np.flatnonzero(np.abs(found - right) > 1e-9)
        if len(wrong):
            k = int(wrong[0])
            places = (
                (reading == 255, "no echo: nothing is learnt"), (not inside[k], "outside of the cone"),
                (gap[k] < -half, "before the arc"), (gap[k] <= half, "in the arc"),
                (True, "behind the arc: nothing is learnt"),
            )  # fmt: skip
            where = next(name for is_there, name in places if is_there)
            raise Wrong(f"reading {reading} in, a cell at {distances[k]:.1f} in and {angles[k]:.3f} rad: it returned "
                        f"{found[k]:.3g}, expected {right[k]:g} ({where}).")


@task("11", points=2)
def fit_wall(answer: Answer, rng: Rng) -> None:
    """Check the line through points: no line is nearer to them."""
    for k in range(TRIES):
        alpha = float(rng.uniform(-pi, pi)) if k % 3 else float(rng.integers(0, 4)) * pi / 2
        rho, along = float(rng.uniform(10, 60)), rng.uniform(-30, 30, 40)
        n, t = np.array([cos(alpha), sin(alpha)]), np.array([-sin(alpha), cos(alpha)])
        points = rho * n + along[:, None] * t + rng.normal(0, 0.5, (40, 2))
        found_alpha, found_rho = numbers(answer, points, shape=(2,)).tolist()
        # The best line of all directions, with its best offset.
        directions = np.linspace(0, pi, 2001)
        squares = np.var(points @ np.array([np.cos(directions), np.sin(directions)]), axis=0)
        found = np.mean((points @ (np.cos(found_alpha), np.sin(found_alpha)) - found_rho) ** 2)
        hint = "Points on a line x cos(alpha) + y sin(alpha) = rho. "
        if abs((found_alpha - alpha) % pi - pi / 2) < 0.05:
            hint += "alpha is the direction of the normal, not that of the wall."
        elif abs(abs(found_rho) - rho) > 1.0:
            hint += "rho is the mean of the points along the normal."
        else:
            hint += "Minimize distances across the line, not along y: the eigenvector of the smaller eigenvalue."
        require(
            found < 1.02 * squares.min() + 1e-6,
            f"The root mean square distance from the line ({found_alpha:.3f} rad, {found_rho:.2f} in) is "
            f"{sqrt(found):.3f} in; the best line has {sqrt(squares.min()):.3f} in. {hint}",
        )
