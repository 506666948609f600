"""What bytes mean, in both languages and both ways. No socket, no clock; the one room that knows construct and struct.

commands > requests, replies                 THE table: a row a command; the layouts of what is asked and answered
           fields | line_fields > runs       the pieces of those, over TCP and on a robot's own line; layouts runs them
language > tcp_frame | serial_frame          calls and replies to bytes and back; whole frames in a stream
terms > mask, models, hello                  what two ends have agreed; bounds, likeness: what cannot have been meant
state > stamps, units                        what a client holds, and where tenths become radians
decode                                       frames in readable form
"""
