"""What is taken for true of a robot, by options, address, or a guess that is said: its body, its sonars, its walls."""
