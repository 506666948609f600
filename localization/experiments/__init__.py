"""Monte Carlo experiments with simulated robots.

figure_trial, __main__    the figures of the thesis, simulated in batches, and their pictures and tables
live_trial, live          filters compared on live robots
disturbed                 a filter with disturbances of robot, map and sonars
lost                      lost robots: detection, recovery, unknown starts
plan                      planned and driven paths
mapping                   maps learned from drives, against the true ones
corridor                  filters on a log of a real corridor
baselines                 scores of simple policies in the environments of Gymnasium
execution                 processes, clusters, cached results and options, for all of them
"""

from nclient.common import use_one_thread

# Each process of an experiment has a core.
use_one_thread()
