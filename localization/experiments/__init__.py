"""Monte Carlo experiments: the thesis' figures, live runs, lost robots, plans."""
