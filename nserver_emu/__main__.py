"""`python -m nserver_emu` is `nserver`."""

from __future__ import annotations

import sys

from nserver_emu.cli import main

sys.exit(main())
