"""Answers to the tasks of notebook 02."""

import cmath
import math

import numpy as np


def sonar_direction__wrong_clockwise(turret, number):
    return turret - number * math.pi / 8


def sonar_direction__wrong_degrees(turret, number):
    return turret + number * 22.5


def sonar_direction__wrong_without_turret(turret, number):
    return number * math.pi / 8


def sonar_direction__right_wrapped(turret, number):
    return cmath.phase(cmath.exp(1j * (turret + math.tau * number / 16)))


def echo_point__wrong_without_ring(x, y, turret, number, reading):
    a = turret + number * math.pi / 8
    return x + reading * math.cos(a), y + reading * math.sin(a)


def echo_point__wrong_clockwise(x, y, turret, number, reading):
    a = turret - number * math.pi / 8
    return x + (9.06 + reading) * math.cos(a), y + (9.06 + reading) * math.sin(a)


def echo_point__wrong_without_robot(x, y, turret, number, reading):
    a = turret + number * math.pi / 8
    return (9.06 + reading) * math.cos(a), (9.06 + reading) * math.sin(a)


def echo_point__right_rotation(x, y, turret, number, reading):
    a = turret + number * math.pi / 8
    rotation = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
    return np.array([x, y]) + rotation @ np.array([9.06 + reading, 0])


def range_to_wall__wrong_line_not_segment(x, y, a, wall):
    x1, y1, x2, y2 = wall
    # The normal of the wall's line: the wall's ends are not checked.
    n = np.array([y1 - y2, x2 - x1])
    t = n @ (x1 - x, y1 - y) / (n @ (math.cos(a), math.sin(a)))
    return t if t > 0 else math.inf


def range_to_wall__wrong_behind_counts(x, y, a, wall):
    x1, y1, x2, y2 = wall
    A = np.array([[math.cos(a), x1 - x2], [math.sin(a), y1 - y2]])
    t, s = np.linalg.solve(A, (x1 - x, y1 - y))
    # A negative t is a wall behind the robot.
    return abs(t) if 0 <= s <= 1 else math.inf


def range_to_wall__wrong_slope(x, y, a, wall):
    x1, y1, x2, y2 = wall
    # A vertical wall has no slope, and is left out.
    if x1 == x2:
        return math.inf
    m = (y2 - y1) / (x2 - x1)
    t = (y1 + m * (x - x1) - y) / (math.sin(a) - m * math.cos(a))
    at = x + t * math.cos(a)
    return t if t > 0 and min(x1, x2) <= at <= max(x1, x2) else math.inf


def range_to_wall__right_solve(x, y, a, wall):
    x1, y1, x2, y2 = wall
    A = np.array([[math.cos(a), x1 - x2], [math.sin(a), y1 - y2]])
    t, s = np.linalg.solve(A, (x1 - x, y1 - y))
    return t if t > 0 and 0 <= s <= 1 else 1e9


def reading_std__wrong_noise_only(r):
    return 0.01 * r


def reading_std__wrong_sum(r):
    # Standard deviations of independent errors do not add up; variances do.
    return 0.01 * r + math.sqrt(1 / 12)


def reading_std__wrong_variance(r):
    return (0.01 * r) ** 2 + 1 / 12


def reading_std__right_experiment(r):
    rng = np.random.default_rng(1)
    # An experiment: readings rounded to whole inches, with noise of 1 percent.
    true = r + rng.uniform(-0.5, 0.5, 200_000)
    return np.std(np.rint(true + 0.01 * r * rng.standard_normal(200_000)) - true)
