"""Position filters: from odometry steps and sonar readings to a pose with its covariance.

belief, odometry            mean and covariance of a state; how a step of the encoders changes them (predict)
sonar_ray, sonar_cone       the expected range of a sonar on a map, and its derivative
update                      the correction by one reading (update), and why a reading is refused
ekf, ukf, smoother, particles, calibration, global_localization    the filters, made by name in registry
"""
