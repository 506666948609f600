"""Path planning, path following and point-to-point navigation on an estimate."""
