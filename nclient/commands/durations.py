"""Seconds on a command line: finite, and not negative.

Rules: a reader for argparse, which says what it wanted.
"""

from __future__ import annotations

import argparse
import math


def seconds(text: str) -> float:
    """A time of 0 s or more. Raises ArgumentTypeError for anything else, inf and nan among it."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"a number of seconds, 0 or more, not {text}")
    return value
