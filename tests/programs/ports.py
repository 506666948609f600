"""Serial ports of the programs of a test.

    select_ports()    the portable transport, if the fixture `serial_ports` asks for it
    reserved(link)    no other test gets the pseudo-terminal behind a link while its server is down
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from nclient.transports import serial

VARIABLE = "NOMAD_TEST_PORTABLE_PORTS"


def select_ports() -> None:
    """Open the ports of this process by the portable transport, if the environment asks for it."""
    if VARIABLE in os.environ:
        serial.needs_portable = lambda port: port != ""


@contextlib.contextmanager
def reserved(link: Path) -> Iterator[None]:
    """Keep the pseudo-terminal behind the link in use after its server was killed.

    A killed server leaves its link. The kernel gives the number of a pseudo-terminal that nobody has open to the
    next one, which may be that of a test that runs at the same time: a client that reconnects would write to it.
    """
    descriptor = os.open(link, os.O_RDWR | os.O_NOCTTY)
    try:
        yield
    finally:
        os.close(descriptor)
