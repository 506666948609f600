"""Does a filter know when it is lost, and only then, and does it find itself again: long runs, kidnappings, starts from
nowhere."""
