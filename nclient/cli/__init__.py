"""The command `nomad` and its subcommands for robots, recordings and the wire protocols."""
