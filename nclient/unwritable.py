"""What to say of a file that cannot be written: its name, why, and what helps.

Rules: on the ground floor, so that whoever writes files says it the same way. Nothing is written here.
"""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Final

_ROOM: Final = "make room on that disk, or name a file on another"
_MAY: Final = "name a file in a folder that is there and may be written to"
_SIZE: Final = "raise the limit on the size of files (ulimit -f)"
_REMEDIES: Final = {errno.ENOSPC: _ROOM, errno.EDQUOT: _ROOM, errno.EFBIG: _SIZE}


def unwritable(path: Path, error: OSError, what: str = "") -> str:
    """`FILE: cannot be written: No space left on device; make room ...`; `what` stands in the file's place after its
    name: `FILE: the report cannot be written: ...`."""
    return f"{path}: {what}{' ' if what else ''}cannot be written: {error.strerror}; {remedy(error)}"


def remedy(error: OSError) -> str:
    """What helps against it."""
    return _REMEDIES.get(error.errno or 0, _MAY)
