"""What is said on one connection, without a port or a clock: bytes in, answers out.

session            Nserver's language        line_session       a robot's own
first_bytes        whether a client was built for 64 bits; acquaintances: who comes back, and under what name
"""
