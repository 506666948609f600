"""Maps, geometry, ray casting, robot bodies and world files, shared by simulation, filters and viewer.

Inches and radians, counter-clockwise positive. No protocol, no simulation, no filters.
"""
