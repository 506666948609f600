"""Suggestions for unknown words."""

from __future__ import annotations

from nclient.errors import closest_match, suggest

KNOWN = ("points_in", "corners_in")


def test_the_nearest_word_is_offered_or_none() -> None:
    assert closest_match("pionts_in", KNOWN) == "points_in"
    assert closest_match("zzz", KNOWN) == closest_match("points_in", ()) == ""


def test_one_right_letter_of_two_is_enough_and_of_more_it_is_not() -> None:
    # One letter of two is equal; in longer words half of the letters must not be enough.
    assert closest_match("vn", ("vm", "sonar")) == "vm"
    assert closest_match("vn", ("pr", "lp")) == ""
    assert closest_match("drive", ("bridge", "draw_line")) == "", "half of its letters are not enough"


def test_unique_prefix_is_suggested() -> None:
    assert closest_match("loc", ("localize", "map")) == "localize"
    assert closest_match("loc", ("localize", "locations")) == closest_match("lo", ("localize",)) == ""


def test_a_question_ends_a_message() -> None:
    assert suggest("pionts_in", iter(KNOWN)) == "; did you mean points_in?"
    assert suggest("pionts_in", KNOWN, before="", after=":? ") == "did you mean points_in:? "
    assert suggest("zzz", KNOWN) == ""
