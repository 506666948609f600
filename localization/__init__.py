"""Where a robot is, by its encoders and its sonars in a map of walls; and what is driven and found out on that.

experiments/      the thesis' figures and more, with the emulator: nothing below knows of them
cli               `nomad localize`; missions/ (`go`, `mission`), calibration/ (`calibrate`), maps/ (`map`)
command_line/     what such commands begin with; runs/: what comes of them; keeping/: going on after a stop
taken/            what is taken for true of a robot that nobody has told: its body, its sonars, its walls
planning/         the shortest way and how to follow it; driving/: to way-points, or without an estimate
live/             localizer: states of a robot in, estimates out
filters/          who does it, all of one interface; filters/finding: where else the robot may be
sonar/            what a sonar reads in the map, and which readings may correct
estimation/       a belief, predicted and corrected: ekf
"""
