"""Command handlers: one table, and one module per group of commands."""
