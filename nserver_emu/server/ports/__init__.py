"""Sockets, pseudo-terminals, and who talks on them.

daemon > connection                    a port for clients; talker: whose turn it is
lines > comings, pseudo_terminal       robots' own lines; cable, faulty_cable: what lies on one
fault_desk                             which lines are unclean; line_options: by the command line
"""
