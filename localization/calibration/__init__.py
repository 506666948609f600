"""Calibration of a robot's wheels and sonars by a guided run."""
