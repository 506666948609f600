"""Generate docs/setups.md: every key of a setup file with its values in the predefined setups."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees
from typing import Final

from nserver_emu.simulation.noise import KEYS, POLAROID, RAY, SETUPS, RobotSetup
from nserver_emu.simulation.settings import Key
from nserver_emu.simulation.sonar import SonarNoise
from worlds.robots import SONARS

NOT_THERE: Final = "—"

_TITLES: Final = {
    "": "Top of the file",
    "motion": "`[motion]`: random errors of the true motion, growing with the distance",
    "odometry": "`[odometry]`: systematic wheel errors",
    "sonar": "`[sonar]`",
    "infrared": "`[infrared]`",
    "compass": "`[compass]`",
}


def blocks() -> dict[str, Iterator[str]]:
    """Return the tables of the page."""
    return {"setups": _tables()}


def _tables() -> Iterator[str]:
    for table, title in _TITLES.items():
        yield from ("", f"## {title}", "")
        yield f"| key | unit | range | {' | '.join(SETUPS)} | meaning |"
        yield f"|---|---|---|{'---|' * len(SETUPS)}---|"
        if table == "sonar":
            models = " | ".join(RAY if isinstance(setup.sonar, SonarNoise) else POLAROID for setup in SETUPS.values())
            yield f"| `model` | | {RAY}, {POLAROID} | {models} | one exact ray with noise, or a Polaroid ring |"
        yield from (_row(key) for key in KEYS if key.table == table)


def _row(key: Key) -> str:
    values = [_value(key, setup) for setup in SETUPS.values()]
    bounds = "true, false" if "true" in values or "false" in values else f"{key.low:g}, {key.high:g}"
    return f"| `{key.name}` | {key.unit} | {bounds} | {' | '.join(values)} | {key.meaning} |"


def _value(key: Key, setup: RobotSetup) -> str:
    """Return a value in the notation of a setup file."""
    value = key.of(setup)
    if value is None:
        return NOT_THERE
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple) and len(value) == SONARS:
        return f"{SONARS} x {value[0]:g}"
    if isinstance(value, tuple):
        return f"[{', '.join(f'{number:g}' for number in value)}]"
    assert isinstance(value, float)
    return f"{degrees(value) if key.in_degrees else value:g}"
