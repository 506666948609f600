"""The portable transport of serial ports for the programs of a test: the fixture `serial_ports` asks for it."""

from __future__ import annotations

import os

from nclient.transports import serial

VARIABLE = "NOMAD_TEST_PORTABLE_PORTS"


def select_ports() -> None:
    """Open the ports of this process by the portable transport, if the environment asks for it."""
    if VARIABLE in os.environ:
        serial.needs_portable = lambda port: port != ""
