"""Fault injection: plans, their execution on frames, and streams with faults."""
