"""The `nomad` subcommands of localization: one module per subcommand."""
