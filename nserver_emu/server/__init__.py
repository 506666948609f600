"""The emulator as a server: conversations, commands, ports. Tenths and bytes at the rim, inches and radians inside.

daemon > door, connection; lines             sockets and ports; talker takes turns; cable, faulty_cable, pseudo_terminal
                                             with comings: what a robot's own line lies on
session | line_session                       a conversation without I/O; first_bytes, acquaintances: whose it is
handlers > motion, questions, senses,        THE table of what a command does, and the rooms of its functions;
           ground > collision, window,       command_table asks them all for docs/commands.md
           packets, hosting
stage > promises, clicks, drivers, holds,    what they act upon: the simulation, with who waits, drives and holds, and
        arm, graphics, traces, transcript,   what a server has besides
        pace
state_reply, laser_vector, axis_units        where inches become tenths; layers: where they become a picture's numbers
limits, access, allowance, patience          what a client may take
control, control_socket, fault_desk          what the owner may do meanwhile; control > switches, obstacles
setting > places; old_setups                 what a simulation is set up from; the original's own files
snapshot > snapshot_objects, trial           the whole of it saved; autosave: again and again
recording; replay                            what was said, and whether it is said again
in_process                                   all this without a port: `sim:`
control_options, line_options,               by the command line
restore_options
"""
