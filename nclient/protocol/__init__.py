"""The two wire protocols without I/O: Nserver over TCP, and the robot's own serial line.

    commands > requests, replies      the command table: one row per command, with the layouts of request and reply
    fields                            construct classes that layouts of the serial line are made of
    codec > serial_framing            calls and replies to bytes and back; whole frames in a byte stream
    wire_state > types                state that both ends share (mask, laser mode); masks, models, stamps, units
    client_state                      State vector, laser, stamps and clock as the client stores them
    decode                            traffic to dictionaries, for `nomad wire decode`, dump, recordings and viewer

This package alone imports construct and struct.
"""
