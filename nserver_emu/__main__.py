"""`python -m nserver_emu` is `nserver`."""

from __future__ import annotations

import sys

from nomad_start import nserver

sys.exit(nserver())
