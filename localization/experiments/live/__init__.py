"""Trials on the real interface: a robot behind an address, whole inches, one sonar after another while it moves."""
