"""Helpers of all packages: files, hints, argument parsing, exit codes, signals, allow lists."""
