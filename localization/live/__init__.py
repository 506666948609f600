"""Filters on a robot's interface: polled states go in (sensor_input), estimates come out (localizer)."""
