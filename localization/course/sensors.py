"""Checks of notebooks 01 to 03: odometry, sonars, a wall follower."""

from math import atan2, cos, degrees, hypot, inf, isinf, pi, radians, sin, sqrt

import numpy as np

from localization.course.tasks import TRIES, Answer, Rng, expect, numbers, require, task, truth_value
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
            (
                (x + distance * cos(heading), y + distance * sin(heading), heading + turn),
                "While driving, the heading is on average that at half of the turn, not that at the beginning.",
            ),
            (
                (x + distance * cos(heading + turn), y + distance * sin(heading + turn), heading + turn),
                "While driving, the heading is on average that at half of the turn, not that at the end.",
            ),
            ((*drive_arc(pose, distance, turn)[:2], heading), "The heading changes by the turn as well."),
            ((*drive_arc(pose, distance, turn)[:2], heading - turn), "A turn to the left is positive."),
            (
                (x - distance * sin(heading + turn / 2), y + distance * cos(heading + turn / 2), heading + turn),
                "Heading 0 is along x: x changes by the cosine, y by the sine.",
            ),
        ]
        expect(
            answer,
            (pose, distance, turn),
            drive_arc(pose, distance, turn),
            (0.02, 0.02, 1e-6),
            angles=(2,),
            mistakes=mistakes,
            hint="Are cosine and sine taken of radians?",
        )


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
        expect(
            answer,
            (before, after),
            (distance, turn),
            (0.05, 1e-6),
            mistakes=mistakes,
            hint="Return the distance along the heading and the turn.",
        )


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
    expect(
        answer,
        (distances, errors),
        alpha,
        0.15 * alpha,
        mistakes=mistakes,
        hint="The mean of error squared is alpha times the distance.",
    )


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
        expect(
            answer,
            (x, y, turret, number, reading),
            (x, y) + (RING_IN + reading) * u,
            0.1,
            mistakes=mistakes,
            hint="Start at the axis and go along the direction of the sonar.",
        )


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
            require(
                found > 1e6,
                f"The ray from ({x:.1f}, {y:.1f}) in the direction {direction:.3f} does not meet the "
                f"wall {np.round(wall, 1).tolist()}; expected math.inf, not {found:.4g}. {hint}",
            )
        else:
            expect(
                answer,
                (x, y, direction, wall),
                right,
                0.01,
                mistakes=[
                    (inf, "The ray meets this wall. Are walls parallel to an axis handled?"),
                    (-right, "Ahead of the sonar a range is positive."),
                    (
                        hypot(x - (wall[0] + wall[2]) / 2, y - (wall[1] + wall[3]) / 2),
                        "That is the distance to its middle.",
                    ),
                ],
            )


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
        expect(
            answer,
            (side, ahead),
            (distance, angle),
            (0.05, 0.005),
            mistakes=mistakes,
            hint="Two points of the wall give its direction.",
        )


@task("03", points=2)
def turn_rate(answer: Answer, rng: Rng) -> None:
    """Check a control law by driving along a simulated wall."""
    wanted = 20.0
    at_goal = float(numbers(answer, wanted, 0.0, wanted, shape=()))
    require(abs(at_goal) < 1.0, f"At the wanted distance and parallel to the wall it turns by {at_goal:.3g} deg/s.")
    for near in (8.0, 50.0):
        rate = float(numbers(answer, near, 0.0, wanted, shape=()))
        require(abs(rate) <= 30.0 + 1e-9, f"{near:.0f} in from the wall it turns by {rate:.3g} deg/s: limit it to ±30.")
        require(
            rate * (wanted - near) > 0.0,
            f"{near:.0f} in from the wall, {wanted:.0f} wanted, it turns by {rate:.3g} "
            "deg/s. The wall is on the right; a turn to the left is positive.",
        )
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
        require(
            found is right,
            f"With {where} at 40 in or more, limit {limit:.0f} in, it returned {found}. "
            "Ahead are the sonars 15, 0 and 1.",
        )
