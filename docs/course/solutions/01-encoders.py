import math

import numpy as np


def step_pose(pose, distance_in, turn_rad):
    x, y, heading = pose
    on_the_way = heading + turn_rad / 2
    return x + distance_in * math.cos(on_the_way), y + distance_in * math.sin(on_the_way), heading + turn_rad


def relative_step(before, after):
    turn = (after[2] - before[2] + math.pi) % (2 * math.pi) - math.pi
    on_the_way = before[2] + turn / 2
    distance = (after[0] - before[0]) * math.cos(on_the_way) + (after[1] - before[1]) * math.sin(on_the_way)
    return distance, turn


def random_error(distances_in, errors_in):
    return np.mean(errors_in**2 / distances_in)
