"""What a simulation is set up from.

setting > places           world, robots, seed, noise; where each of them stands
old_setups                 the original's own files; restore_options: what a saved run has settled already
"""
