"""The two wire protocols without I/O: Nserver over TCP, and the robot's own serial line.

    commands > layouts, replies       the command table: one row per command, with the layouts of request and reply
    codec > serial_framing            calls and replies to bytes and back; whole frames in a byte stream
    types                             models, masks, stamps, units; the state that both ends share (mask, laser mode)
    client_state                      State vector, laser, stamps and clock as the client stores them
    decode                            traffic to dictionaries, for `nomad wire decode`, dump, recordings and viewer

This package alone imports construct and struct.
"""
