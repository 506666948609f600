"""Whose body a robot has: what its address says of it, else what --body says.

Rules: pure; an address tells by `model=`, a sim: address by `robot=` or, without it, that it is an n150. Where both
speak they must agree: sizes, sonars and turret of another robot make every estimate wrong.
"""

from __future__ import annotations

from typing import Final

from nclient.address import parsed
from nclient.connect import address_or_default
from nclient.errors import AddressError

SIMULATION: Final = "sim"


def body_of(option: str | None, model: str, address: str | None) -> str:
    """The name of the body: the option's, where the address does not tell; else `model`, as the address has it.

    `address` None: the default's. Raises AddressError where they contradict.
    """
    there = parsed(address_or_default(address))
    told = there.scheme == SIMULATION or "model" in there.options
    if option is None or (told and option == model):
        return model
    if told:
        raise AddressError(f"--body {option}: the robot at {there.text} is of model {model}; leave --body out")
    return option
