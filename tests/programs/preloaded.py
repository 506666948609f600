"""The last module that the fork server imports: it exempts all that is there from the garbage collection of programs.

A daemon searches all objects once when it starts (`rare_collection`), which takes a tenth of a second otherwise.
"""

from __future__ import annotations

import gc

import tests.programs.forked
import tests.programs.ports

__all__ = ["tests"]

gc.collect()
gc.freeze()
