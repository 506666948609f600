"""Answers to the tasks of notebook 03."""

import math

import numpy as np


def _fit(side, ahead, ring=9.06):
    # Sonars 12 and 13 point to the right and 22.5 degrees ahead of it.
    a = math.radians(-67.5)
    # The two points that the sonars measure, in the robot's frame.
    p, q = np.array([0, -(ring + side)]), (ring + ahead) * np.array([math.cos(a), math.sin(a)])
    return p, q, math.atan2(*(q - p)[::-1])


def wall_on_the_right__wrong_without_ring(side, ahead):
    p, _, angle = _fit(side, ahead, 0)
    return -p[1] * math.cos(angle), angle


def wall_on_the_right__wrong_not_perpendicular(side, ahead):
    return side + 9.06, _fit(side, ahead)[2]


def wall_on_the_right__wrong_sign(side, ahead):
    p, _, angle = _fit(side, ahead)
    return -p[1] * math.cos(angle), -angle


def wall_on_the_right__right_cross_product(side, ahead):
    p, q, angle = _fit(side, ahead)
    # The distance of the origin from the line through both points.
    return np.array([abs(p[0] * q[1] - p[1] * q[0]) / np.linalg.norm(q - p), angle])


def turn_rate__wrong_sign(distance, angle, wanted):
    return max(-30, min(30, 2 * (distance - wanted) - 60 * angle))


def turn_rate__wrong_without_limit(distance, angle, wanted):
    return 4 * (wanted - distance) + 90 * angle


def turn_rate__wrong_without_angle(distance, angle, wanted):
    return max(-30, min(30, 3 * (wanted - distance)))


def turn_rate__wrong_weak(distance, angle, wanted):
    return max(-30, min(30, 0.05 * (wanted - distance) + 60 * angle))


def turn_rate__right_wanted_angle(distance, angle, wanted):
    # Turns towards a wanted angle, which grows with the distance that is missing.
    towards = np.clip(0.05 * (wanted - distance), -0.5, 0.5)
    return float(np.clip(np.degrees(towards + angle), -30, 30))


def is_blocked__wrong_one_sonar(sonars, limit):
    return sonars[0] < limit


def is_blocked__wrong_all(sonars, limit):
    return min(sonars) < limit


def is_blocked__wrong_mean(sonars, limit):
    # The mean hides one near reading among far ones.
    return (sonars[15] + sonars[0] + sonars[1]) / 3 < limit


def is_blocked__right_numpy(sonars, limit):
    return (np.array(sonars)[[15, 0, 1]] < limit).any()
