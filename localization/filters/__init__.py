"""Position filters: from odometry steps and sonar readings to a pose with its covariance.

belief, odometry            mean and covariance of a state; how a step of the encoders changes them (predict)
sonar_ray, sonar_cone       the expected range of a sonar on a map, and its derivative
surface                     walls of real buildings, whose errors stay over some distance
update                      the correction by one reading (update), and why a reading is refused
health, heading_test        the monitor of an estimate; evidence of another heading
range_table, pose_search    expected ranges from anywhere on a map, and the search for a pose by them
compiled                    the same functions as machine code
ekf, ukf, smoother, particles, calibration, global_localization    the filters, made by name in registry
"""
