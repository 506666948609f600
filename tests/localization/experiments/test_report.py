"""The table: each number beside its reference, and notes where the thesis cannot be right."""

from __future__ import annotations

from localization.experiments.__main__ import table
from localization.experiments.figure_trial import FIGURES, Summary, figure_setup


def some_summary(name: str, *, filtered: bool = True) -> Summary:
    return Summary(
        figure=name,
        seeds=100,
        steps_median=1440.0,
        steps_thesis=FIGURES[name].steps_thesis,
        end_error_median_in=0.04,
        reached=99,
        rmse_position_in=0.05,
        rmse_heading_deg=0.13,
        nees_mean=3.1 if filtered else None,
        nees_band95=[2.54, 3.5] if filtered else None,
        nis_mean=0.99 if filtered else None,
        pcrb_position_in=0.04 if filtered else None,
    )


def format_entry(name: str, *, filtered: bool = True) -> list[str]:
    figure = FIGURES[name]
    return table(figure, figure_setup(figure), some_summary(name, filtered=filtered)).splitlines()


def test_every_number_stands_beside_its_reference() -> None:
    lines = format_entry("5.4")
    assert lines[0] == "Figure 5.4: With the filter"
    # Value and reference of each row, for a summary with known numbers.
    for name, value, note in (
        ("every goal reached", "99", "of 100"),
        ("steps, median", "1440", "1199 in the text"),
        ("position RMSE", "0.0500 in", "1.250 x the Cramer-Rao bound of 0.0400 in"),
        ("NEES, mean", "3.10", "3 is right, 95 % band 2.54 to 3.50"),
        ("NIS a beam, mean", "0.990", "1 is right"),
    ):
        (line,) = (line for line in lines if line.strip().startswith(name))
        assert f" {value} " in line
        assert note in line


def test_impossible_step_count_of_thesis_is_noted() -> None:
    note = " ".join(format_entry("5.4")[-2:])
    assert "1199 steps cannot be" in note
    assert "1442 at least" in note
    assert "1438 to come within 0.25 in" in note


def test_possible_step_count_has_no_note() -> None:
    assert not any("cannot be" in line for name in ("5.6", "5.8") for line in format_entry(name))


def test_numbers_without_meaning_are_not_shown() -> None:
    text = "\n".join(format_entry("5.2", filtered=False))
    assert "NEES" not in text
    assert "NIS" not in text
    assert "Cramer" not in text
    assert "None" not in text
