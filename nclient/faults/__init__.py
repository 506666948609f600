"""Faults on purpose: a plan of them, what it does to the bytes of a line, and a stream that has them."""
