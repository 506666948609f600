"""Checks of notebooks 10 and 11: calibration, maps."""

from math import cos, pi, radians, sin, sqrt

import numpy as np

from localization.course.tasks import TRIES, Answer, Rng, expect, numbers, require, task

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
        expect(
            answer,
            (counted, measured),
            scale,
            0.003,
            mistakes=mistakes,
            hint="Minimize the squares of measured - scale * counted.",
        )


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
        expect(
            answer,
            (distances, turns, true),
            (scale, drift),
            (0.003, 1e-4),
            mistakes=mistakes,
            hint="Two unknowns: true = scale * turns + drift * distances. np.linalg.lstsq solves it.",
        )


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
        (
            sigma / np.sqrt(np.diag(information)),
            "Invert the matrix, then take its diagonal: the unknowns are correlated.",
        ),
        (right[::-1], "The scale first, then the drift."),
        (sigma * np.sqrt(np.diag(information)), "More data makes the result more certain: the inverse of A' A."),
    ]
    expect(
        answer,
        (distances, turns, sigma),
        right,
        0.06 * right,
        mistakes=mistakes,
        hint="P = sigma^2 inv(A' A), with the columns turns and distances of A.",
    )


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
            where = (
                "no echo: nothing is learnt"
                if reading == 255
                else "outside of the cone"
                if not inside[k]
                else "before the arc"
                if gap[k] < -half
                else "in the arc"
                if gap[k] <= half
                else "behind the arc: nothing is learnt"
            )
            require(
                False,
                f"reading {reading} in, a cell at {distances[k]:.1f} in and {angles[k]:.3f} rad: it returned "
                f"{found[k]:.3g}, expected {right[k]:g} ({where}).",
            )


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
