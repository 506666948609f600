"""Whose state packet is this? What a packet that does not fit tells of the model that sent it.

    N200              the length of its full mask, pixels or lines    N150, Scout    their fixed length
    N150 or Scout     the four bits of the first bumper byte that always read 1, or not

Rules: pure, and a guess: good enough for a message that names the remedy, never for reading an answer.
"""

from __future__ import annotations

from nclient.errors import WireError
from nclient.protocol.mask import BUMPER_SLOT
from nclient.protocol.models import MODELS, N150, N200, SCOUT, Model
from nclient.protocol.replies import LINE_STATE, Reply
from nclient.protocol.terms import line_terms

_LINE_MODE = 1


def model_like(data: bytes) -> Model | None:
    """The model that sends such a state packet, None where it is nobody's."""
    fixed = _read(data, N150)
    if fixed is not None:
        return N150 if fixed.slots[BUMPER_SLOT] & N150.bumper_rest == N150.bumper_rest else SCOUT
    return N200 if _read(data, N200) or _read(data, N200, _LINE_MODE) else None


def is_it_another(model: Model, data: bytes | None = None) -> str:
    """What to try instead of this model: the one that the packet looks like, else the others there are."""
    like = model_like(data) if data is not None else None
    if like is None:
        others = " or ".join(f"model={name}" for name in MODELS if name != model.name)
        return f"is it a {model.name}? Else say {others} in the address"
    if like is model:
        return ""
    return f"it looks like a {like.name}'s: say model={like.name} in the address"


def _read(data: bytes, model: Model, laser_mode: int | None = None) -> Reply | None:
    terms = line_terms(model)
    if laser_mode is not None:
        terms.note_laser_mode(laser_mode)
    try:
        return LINE_STATE.parse(data, terms)
    except WireError:
        return None
