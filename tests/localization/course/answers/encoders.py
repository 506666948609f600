"""Answers to the tasks of notebook 01: TASK__wrong_REASON and TASK__right_REASON."""

import math

import numpy as np


def step_pose__wrong_start_heading(pose, d, a):
    # The heading at the beginning of the step instead of that in its middle.
    return pose[0] + d * math.cos(pose[2]), pose[1] + d * math.sin(pose[2]), pose[2] + a


def step_pose__wrong_swapped(pose, d, a):
    h = pose[2] + a / 2
    return pose[0] + d * math.sin(h), pose[1] + d * math.cos(h), pose[2] + a


def step_pose__wrong_no_turn(pose, d, a):
    h = pose[2] + a / 2
    return pose[0] + d * math.cos(h), pose[1] + d * math.sin(h), pose[2]


def step_pose__wrong_position_only(pose, d, a):
    return pose[0] + d * math.cos(pose[2] + a / 2), pose[1] + d * math.sin(pose[2] + a / 2)


def step_pose__right_exact_arc(pose, d, a):
    x, y, h = pose
    # The exact arc of radius d / a, which the check must accept beside the approximation.
    r = d / a
    return np.array([[x + r * (math.sin(h + a) - math.sin(h))], [y - r * (math.cos(h + a) - math.cos(h))], [h + a]])


def step_pose__right_complex_list(pose, d, a):
    z = complex(pose[0], pose[1]) + d * complex(math.cos(pose[2] + a / 2), math.sin(pose[2] + a / 2))
    # A heading that differs by whole turns is the same one.
    return [z.real, z.imag, (pose[2] + a) % (2 * math.pi) - 2 * math.pi]


def relative_step__wrong_unwrapped(before, after):
    h = (before[2] + after[2]) / 2
    d = (after[0] - before[0]) * math.cos(h) + (after[1] - before[1]) * math.sin(h)
    # The difference of headings is not wrapped: it jumps at 180 degrees.
    return d, after[2] - before[2]


def relative_step__wrong_unsigned(before, after):
    a = (after[2] - before[2] + math.pi) % (2 * math.pi) - math.pi
    # A distance without sign: the robot may have driven backwards.
    return math.hypot(after[0] - before[0], after[1] - before[1]), a


def relative_step__wrong_sign_of_turn(before, after):
    a = (before[2] - after[2] + math.pi) % (2 * math.pi) - math.pi
    return (after[0] - before[0]) * math.cos(before[2]) + (after[1] - before[1]) * math.sin(before[2]), a


def relative_step__right_atan2(before, after):
    a = math.atan2(math.sin(after[2] - before[2]), math.cos(after[2] - before[2]))
    dx, dy = after[0] - before[0], after[1] - before[1]
    return math.copysign(math.hypot(dx, dy), dx * math.cos(before[2]) + dy * math.sin(before[2])), a


def random_error__wrong_std(d, e):
    return np.sqrt(np.mean(e**2 / d))


def random_error__wrong_not_per_inch(d, e):
    return np.mean(e**2)


def random_error__wrong_signed(d, e):
    return np.mean(e / d)


def random_error__right_sums(d, e):
    return sum(x * x for x in e) / sum(d)


def random_error__right_slope(d, e):
    # A least-squares line through the origin is another right estimate of the slope.
    return np.linalg.lstsq(d[:, None], e**2, rcond=None)[0]
