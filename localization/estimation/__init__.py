"""What a filter holds to be true of a state, and how motion and readings change it: gaussians, nothing of robots' APIs.

systematic > motion > belief       encoders that err the same each time, how they move a robot, mean and covariance
ekf | updates > sigma_points       predict and correct; rules of correction
mixture > candidates, repeats      one reading of several things, and one heard again where the robot stands
observation, chi_square            what beams say of a state, and how much of that is chance
"""
