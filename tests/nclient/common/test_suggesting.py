"""Which known word is offered for an unknown one, and how it is said."""

from __future__ import annotations

from nclient.common.hints import nearest, suggest

KNOWN = ("points_in", "corners_in")


def test_the_nearest_word_is_offered_or_none() -> None:
    assert nearest("pionts_in", KNOWN) == "points_in"
    assert nearest("zzz", KNOWN) == nearest("points_in", ()) == ""


def test_one_right_letter_of_two_is_enough_and_of_more_it_is_not() -> None:
    assert nearest("vn", ("vm", "sonar")) == "vm"
    assert nearest("vn", ("pr", "lp")) == ""
    assert nearest("drive", ("bridge", "draw_line")) == "", "half of its letters are not enough"


def test_the_only_word_that_begins_so_is_meant_however_long_it_is() -> None:
    assert nearest("loc", ("localize", "map")) == "localize"
    assert nearest("loc", ("localize", "locations")) == nearest("lo", ("localize",)) == ""


def test_a_question_ends_a_message() -> None:
    assert suggest("pionts_in", iter(KNOWN)) == "; did you mean points_in?"
    assert suggest("pionts_in", KNOWN, before="", after=":? ") == "did you mean points_in:? "
    assert suggest("zzz", KNOWN) == ""
