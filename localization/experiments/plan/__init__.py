"""Random ways through the shipped worlds, planned and driven with noise on: reached, without touching, how long."""
