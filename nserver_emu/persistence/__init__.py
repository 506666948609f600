"""Snapshots, recordings and replays of a simulation."""
