"""docs/setups.md: every key of a setup file with what the named setups have there, from the setups themselves.

    python -m nserver_emu.simulation.setup_page > docs/setups.md          (scripts/setup-page does that)

Rules: no number is written by hand.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees
from typing import Final

from nserver_emu.simulation.noise import KEYS, RAY, SETUPS, Key, RobotSetup
from nserver_emu.simulation.sonar import SonarNoise
from worlds.robots import SONARS

NOT_THERE: Final = "—"

_HEAD: Final = f"""\
# Setups

How much like a real robot a simulated one is. `nserver --setup NAME` and `sim:WORLD?setup=NAME` take a named one:

- **ideal** axes jump to their speed, motion is exact, one exact ray a sonar (the default)
- **noisy** axes ramp, motion strays like a random walk, sonars with 1 % noise: the settings of the experiments
- **measured** as noisy, but the sonars hear like a Polaroid ring (cone, mirrors, second echoes, cross-talk), and
  infrareds, compass and clock err as well
- **worn** as noisy, on wheels that err the same way every time

or a file in TOML, `nserver --setup room12.toml`, `sim:WORLD?setup=room12.toml`, that is made from one of them:

```toml
base = "measured"             # ideal, where left out

[sonar]
dead = [3, 11]
std_share = 0.02

[odometry]
scales = [1.01, 1.0, 1.0]     # the wheels are 1 % larger than the robot believes
slip_in = 0.1
```

What a file leaves out is as in its base. `name` is what the setup is called, the file's name where left out;
`model = "polaroid"` or `"{RAY}"` in `[sonar]` chooses how sonars hear, and what both models have stays. A key that is
unknown or out of its range is refused with the range or the nearest key.

What the numbers do, formula by formula: [sensors and noise](sensors.md#the-noise-models).

The tables are made by `scripts/setup-page` from the setups themselves; a test compares. {NOT_THERE} means that the
sonar model of that setup, one exact ray, has no such number; `model = "polaroid"` brings those of *measured*.
"""

_TITLES: Final = {
    "": "At the top of the file",
    "motion": "`[motion]`: the true motion strays from the commanded one, a random walk that grows with the way",
    "odometry": "`[odometry]`: what the wheels get wrong every time",
    "sonar": "`[sonar]`",
    "infrared": "`[infrared]`",
    "compass": "`[compass]`",
}


def markdown() -> str:
    """The whole page."""
    return _HEAD + "".join(f"{line}\n" for line in _tables())


def _tables() -> Iterator[str]:
    for table, title in _TITLES.items():
        yield from ("", f"## {title}", "")
        yield f"| key | unit | from, to | {' | '.join(SETUPS)} | what it is |"
        yield f"|---|---|---|{'---|' * len(SETUPS)}---|"
        if table == "sonar":
            ears = [RAY if isinstance(setup.sonar, SonarNoise) else "polaroid" for setup in SETUPS.values()]
            yield f"| `model` | | {RAY}, polaroid | {' | '.join(ears)} | one exact ray with noise, or a Polaroid ring |"
        yield from (_row(key) for key in KEYS if key.table == table)


def _row(key: Key) -> str:
    values = [_told(key, setup) for setup in SETUPS.values()]
    bounds = "true, false" if "true" in values or "false" in values else f"{key.low:g}, {key.high:g}"
    return f"| `{key.name}` | {key.unit} | {bounds} | {' | '.join(values)} | {key.meaning} |"


def _told(key: Key, setup: RobotSetup) -> str:
    """A value as a file would have it."""
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


if __name__ == "__main__":
    print(markdown(), end="")
