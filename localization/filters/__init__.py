"""Filters of one interface: motion and echoes go in, a belief comes out. `table.make` names them all."""
