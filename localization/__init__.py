"""Where a robot is, by its encoders and its sonars in a map of walls; and what is driven and found out on that.

localizer > told, filters/                   states in, estimates out; echoes, odometry: what is new, and where it was
ekf | updates > sigma_points                 predict and correct; belief, motion, systematic: a state and how it moves
gating > measurement, observation            exact rays, which may correct; single_beam, ring_code: the same, quicker
mixture > candidates; cone > reflectors      all that a real sonar's cone may hear; single_cone: the same, quicker
watch > chi_square; contest > search > atlas whether the estimate can be believed, and where else the robot may be
surroundings, range_noise, calibrated        what is known beforehand; body_taken, sonars_taken: and who says so
resuming > kept_file > kept                  going on after a stop
navigation > control, obstruction; groping   driving on it; lag, steadying, pace: what a live robot takes besides
planning/ missions/ calibration/ maps/       ways, programs, what a robot gets wrong, what a map tells
cli > outset > readers                       `nomad localize`; run, witness, drawing, publishing: what came of it
experiments/                                 the thesis' figures and more, with the emulator: nothing here knows of them
"""
