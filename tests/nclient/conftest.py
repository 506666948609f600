"""The client's tests meet an Nserver that answers by a script: answering.py, imported by name."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
