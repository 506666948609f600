"""Which known word is offered for an unknown one, and how it is said."""

from __future__ import annotations

from nclient.suggesting import did_you_mean, nearest

KNOWN = ("points_in", "corners_in")


def test_the_nearest_word_is_offered_or_none() -> None:
    assert nearest("pionts_in", KNOWN) == "points_in"
    assert nearest("zzz", KNOWN) == nearest("points_in", ()) == ""


def test_how_like_it_has_to_be_is_the_askers() -> None:
    assert nearest("points", ("pair",)) == ""
    assert nearest("points", ("pair",), likeness=0.3) == "pair"


def test_a_question_ends_a_message() -> None:
    assert did_you_mean("pionts_in", iter(KNOWN)) == "; did you mean points_in?"
    assert did_you_mean("pionts_in", KNOWN, before="", after=":? ") == "did you mean points_in:? "
    assert did_you_mean("zzz", KNOWN) == ""
