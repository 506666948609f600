"""Path planning and path following."""
