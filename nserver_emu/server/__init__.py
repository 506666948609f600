"""The emulator as a server: sessions, command handlers, connections and the daemon.

Wire units (tenths) appear in sessions, handlers and the state encoder; simulation and context use inches and radians.
"""
