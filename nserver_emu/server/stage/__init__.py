"""What commands act upon: the simulation, and what a server has besides; inches and radians here, tenths where told.

stage > promises, clicks, drivers, holds       who waits, counts, drives, holds
        arm, graphics, traces, transcript, pace    what a server has besides robots in a world
state_reply, laser_vector > axis_units         where inches become tenths; layers: where they become a picture's numbers
"""
