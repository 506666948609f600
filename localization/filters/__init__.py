"""Filters of one interface (method): motion and echoes go in, a belief comes out. `table.make` names them all.

table > kalman, smoother, particles, calibrating, finding/    the filters; surroundings: what they know beforehand
hearing > sense; likelihood                                   how a gaussian takes one reading in, and how particles do
watch                                                         whether the estimate can be believed
"""
