"""Whether a robot is well, without moving it."""
