"""The error tree: one root, the standard errors it is married to, and a refusal that survives a process pool."""

from __future__ import annotations

import pickle
import re

import pytest

from nclient import errors


@pytest.mark.parametrize(
    ("error", "standard"),
    [
        (errors.AddressError, ValueError),
        (errors.ConnectionLost, ConnectionError),
        (errors.ReplyTimeout, TimeoutError),
        (errors.WireError, ValueError),
        (errors.WorldFileError, ValueError),
        (errors.StartError, ValueError),
        (errors.ExtraMissing, ImportError),
        (errors.RobotRefused, Exception),
    ],
)
def test_each_error_has_the_root_and_a_standard_parent(error: type[Exception], standard: type[Exception]) -> None:
    assert issubclass(error, errors.NomadError)
    assert issubclass(error, standard)
    assert error.__name__ in (errors.__doc__ or "")


def test_the_tree_is_drawn_whole() -> None:
    drawn = re.findall(r"── (\w+)(?: \((\w+)\))? ", errors.__doc__ or "")
    there = {name: error for name, error in vars(errors).items() if isinstance(error, type)}
    assert {name for name, _ in drawn} == there.keys() - {"NomadError"}
    assert {name: married for name, married in drawn if married} == {
        name: error.__bases__[1].__name__ for name, error in there.items() if len(error.__bases__) > 1
    }


@pytest.mark.parametrize(
    ("refusal", "said"),
    [
        (errors.RobotRefused("get_ls", 4), "get_ls was refused: not available on this robot (error 4)"),
        (errors.RobotRefused("vm", None), "vm was refused: NAK"),
        (errors.RobotRefused("vm", 77), "vm was refused: a code nobody documents (error 77)"),
        (errors.RobotRefused("pa", None, "an N150 has none"), "pa was refused: an N150 has none"),
    ],
)
def test_a_refusal_says_what_and_why_and_survives_pickling(refusal: errors.RobotRefused, said: str) -> None:
    assert str(refusal) == said
    again = pickle.loads(pickle.dumps(refusal))
    assert (str(again), again.command, again.code) == (said, refusal.command, refusal.code)
