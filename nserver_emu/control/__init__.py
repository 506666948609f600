"""Control of a daemon: the control socket, its commands and `nserver ctl`; snapshots, recordings and replays."""
