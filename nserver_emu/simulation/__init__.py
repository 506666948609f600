"""Simulation of robots in inches, radians, seconds. No clock, no socket, no wire units; time is an argument.

simulation > multi_robot > robot              which robots may meet
             robot > drive > axis             commanded motion     > segments   the resulting path
                   > odometry, collision      the errors of wheels and encoders; contact and bumpers
                   > sonar, sensors           what is measured     > noise: errors and setups; models: which robot
"""

import logging

# As a library the emulator logs nothing, unless the program that uses it sets up logging. Here, in the package that all
# others import, because importing `logging` in the root would delay the start of `nserver`.
logging.getLogger("nserver_emu").addHandler(logging.NullHandler())
