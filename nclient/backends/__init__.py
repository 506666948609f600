"""Backends execute calls: one module per protocol, and wrappers that add recovery, safety and limits."""
