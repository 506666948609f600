"""Localization of a robot by encoders and sonars in a map of walls, and navigation on the estimate.

Packages, from the lowest layer to the highest:

filters/          belief, odometry, sonar models, and the filters (EKF, UKF, smoother, particles, global localization)
plot              plots of a run: trajectory, errors, innovations, NEES
live/             the localizer of a connected robot: states in, estimates out; saved estimates, publishing, pictures
navigation/       paths, roadmap, planner, path follower, obstacles, pilot, calibration drive, missions
mapping/          maps learned by driving, their comparison with drives, and how well they localize
cli/              the commands localize, go, mission, calibrate, map of `nomad`
experiments/      figures of the thesis and further experiments with simulated robots
"""
