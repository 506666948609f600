"""Monte Carlo experiments with simulated robots.

figure_trial, results, output   the figures of the thesis, simulated in batches
live_trial, live                filters compared on live robots
lost_trial, lost                detection of a lost estimate, and recovery
plan                            planned and driven paths
execution                       processes, clusters and cached results, for all of them
"""
