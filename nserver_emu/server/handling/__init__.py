"""THE table of what a command does, and the rooms of its functions.

handlers > motion, questions, senses, packets, hosting
           ground > collision, window           the world, what is drawn on it
switches, obstacles                             what an owner and the page may do besides
command_table                                   asks them all for docs/commands.md
"""
