"""Path planning, path following, driving to waypoints and missions on an estimate."""
