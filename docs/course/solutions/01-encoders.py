import math

import numpy as np


def step_pose(pose, distance_in, turn_rad):
    x, y, heading = pose
    middle = heading + turn_rad / 2
    return x + distance_in * math.cos(middle), y + distance_in * math.sin(middle), heading + turn_rad


def relative_step(before, after):
    turn = (after[2] - before[2] + math.pi) % (2 * math.pi) - math.pi
    middle = before[2] + turn / 2
    distance = (after[0] - before[0]) * math.cos(middle) + (after[1] - before[1]) * math.sin(middle)
    return distance, turn


def random_error(distances_in, errors_in):
    return np.mean(errors_in**2 / distances_in)
