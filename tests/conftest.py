"""What all tests share: the recorded exchanges' loader can be imported by name."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "nclient" / "protocol"))
sys.path.insert(0, str(Path(__file__).parent / "nserver_emu" / "server"))
sys.path.insert(0, str(Path(__file__).parent / "nserver_emu" / "gateway"))
