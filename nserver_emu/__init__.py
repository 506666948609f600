"""The emulator: a simulated Nomad robot behind Nserver's protocol, run by `nserver`, or by `sim:` in one's own process.

As a library it logs nothing anywhere unless the program that uses it sets up logging.
"""

from __future__ import annotations

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())
