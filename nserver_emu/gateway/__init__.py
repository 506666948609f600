"""Nserver's clients on a real robot: the same calls, answered by what another address leads to."""
