"""Runtime control of a daemon: the control socket, its commands, and `nserver ctl`."""
