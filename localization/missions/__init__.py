"""What a robot shall do, as a program of a few verbs or a list of them in a file, and the report of what it did."""
