"""Filters on a robot's API: states that were polled go in, estimates come out.

localizer > told, echoes, odometry    what a robot tells, what of it is new, and where the encoders were meanwhile
calibrated, lag                       a robot that is known to err; clocks that come in steps
fit                                   whether what is heard fits what the filter was told of its robot
"""
