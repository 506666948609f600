"""Physics of simulated robots in inches, radians, seconds. No clock, no socket, no wire units; time is an argument.

simulation > robot > drive > axis             what was told        > stretch    the path that comes of it
                   > encoders | chassis       believed | true      > contact, bumpers
                   > sonar                    what is seen         noise, setup, models: how real, and which robot
"""
