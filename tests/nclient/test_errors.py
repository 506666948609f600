"""Errors have one root and a standard parent; refusals can be pickled."""

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


def test_the_module_docstring_shows_the_whole_tree() -> None:
    documented = re.findall(r"── (\w+)(?: \((\w+)\))? ", errors.__doc__ or "")
    classes = {name: kind for name, kind in vars(errors).items() if isinstance(kind, type)}
    defined = {name: error for name, error in classes.items() if issubclass(error, Exception)}
    assert {name for name, _ in documented} == defined.keys() - {"NomadError"}
    assert {name: parent for name, parent in documented if parent} == {
        name: error.__bases__[1].__name__ for name, error in defined.items() if len(error.__bases__) > 1
    }


@pytest.mark.parametrize(
    ("refusal", "message"),
    [
        (errors.RobotRefused("get_ls", 4), "get_ls was refused: not available on this robot (error 4)"),
        (errors.RobotRefused("vm", None), "vm was refused: NAK"),
        (errors.RobotRefused("vm", 77), "vm was refused: undocumented code (error 77)"),
        (errors.RobotRefused("pa", None, "an N150 has none"), "pa was refused: an N150 has none"),
    ],
)
def test_a_refusal_has_a_message_and_can_be_pickled(refusal: errors.RobotRefused, message: str) -> None:
    assert str(refusal) == message
    again = pickle.loads(pickle.dumps(refusal))
    assert (str(again), again.command, again.code) == (message, refusal.command, refusal.code)
