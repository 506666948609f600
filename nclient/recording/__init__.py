"""What was said between a program and a robot, kept in a file, and what such a file is good for."""
