"""The emulator as a server: conversations, commands, ports. Tenths and bytes at the rim, inches and radians inside.

control                what the owner may do meanwhile
ports                  sockets, pseudo-terminals, who talks on them
keeping                saved, restored, recorded, replayed
in_process             all this without a port: `sim:`
handling               THE table of what a command does, and its functions
stage                  what they act upon: the simulation, with who waits, drives and holds
conversation           what is said on one connection, without I/O
admission, setting_up  what a client may take; what a simulation is set up from

Rules: imports run down this list; each room's __init__ has its own map.
"""
