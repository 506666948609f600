"""From where the robot is to where it shall be, without touching: a path, and how to follow it on an estimate."""
