"""Simulation of robots in inches, radians, seconds. No clock, no socket, no wire units; time is an argument.

simulation > multi_robot > robot              which robots may meet
             robot > drive > axis             commanded motion     > segments   the resulting path
                   > encoders | chassis       reported | true pose > collision  contact and bumpers
                   > sonar, infrared, laser, compass               > noise, odometry: errors; models: which robot
"""
