"""Byte streams: TCP, serial ports and peers in this process, and listeners that accept them. No protocol."""
