"""The command `nomad`: one module per subcommand."""
