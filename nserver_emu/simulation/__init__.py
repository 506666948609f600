"""Physics of simulated robots in inches, radians, seconds. No clock, no socket, no wire units; time is an argument.

simulation > company > robot                  who is near whom
             robot > drive > axis             what was told        > stretch    the path that comes of it
                   > encoders | chassis       believed | true      > contact, bumpers
                   > sonar                    what is seen         noise, odometry, setup: how real; models: which robot
"""
