"""Subcommands of `nomad` that need nothing but the client: a module each."""
