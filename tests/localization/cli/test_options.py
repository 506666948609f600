"""Options shared by the commands of localization."""

from __future__ import annotations

import argparse
import math

import pytest

from localization.cli.arguments import add_resume_options


def test_old_name_of_displacement_std_works_with_a_warning(capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    add_resume_options(parser)
    options = parser.parse_args(["--moved-std", "1,2,90"])
    assert options.displacement_std == pytest.approx((1.0, 2.0, math.pi / 2))
    assert "--displacement-std" in capsys.readouterr().err
    assert parser.parse_args([]).displacement_std is None
