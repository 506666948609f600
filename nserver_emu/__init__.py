"""The emulator: a simulated Nomad robot behind the protocol of Nserver, run by `nserver`, or in-process by `sim:`."""
