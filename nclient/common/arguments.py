"""Arguments of a command line, read by argparse, which here also says what was probably meant.

    nomad --hlep                    no option --hlep; did you mean --help?
    nomad wire --line seriall       argument --line: no 'seriall'; there are tcp, tcp64, serial; did you mean serial?

    nomad completion                the following arguments are required: shell

Rules: whatever argparse says is said by it; an option that nobody knows is named before all else that is wrong, since
it is what the others come from; nothing that may be left out is asked for.

Seconds on a command line: finite, and not negative.

Rules: a reader for argparse, which says what it wanted.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Any, NoReturn

from nclient.common.hints import nearest, suggest


class Parser(argparse.ArgumentParser):
    """An ArgumentParser with suggestions; its subparsers are of the same kind."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse does; ends with a suggestion where a long option is unknown."""
        self._ask_for_no_more_than_must_be()
        given: Sequence[str] = () if args is None else tuple(args)
        known = self._options()
        if self._subparsers is None:
            for word in given[: given.index("--")] if "--" in given else given:
                name = word.partition("=")[0]
                if name.startswith("--") and not any(option.startswith(name) for option in known):
                    self._refuse(name)
        return super().parse_known_args(args, namespace)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse does, with options among other words; what is left over is told with the nearest option."""
        options, left = self.parse_known_args(args, namespace)
        if left and self._subparsers is None and not any(word.startswith("-") for word in left):
            options, left = self.parse_known_intermixed_args(args, namespace)
        if left and left[0].startswith("-"):
            self._refuse(left[0].partition("=")[0])
        if left:
            self.error(f"too many arguments: {' '.join(left)}")
        return options

    def _ask_for_no_more_than_must_be(self) -> None:
        """To argparse, up to a late Python 3.13, words of which there may be none are required."""
        for action in self._actions:
            if action.nargs == argparse.ZERO_OR_MORE and not action.option_strings:
                action.required = False

    def _refuse(self, name: str) -> NoReturn:
        known = {option.strip("-"): option for option in self._options()}  # all have dashes: those make none alike
        near = known.get(nearest(name.strip("-"), known))
        hint = f"; did you mean {near}?" if near else ""
        self.error(f"no option {name}{hint}; --help shows them all")

    def _options(self) -> list[str]:
        return [option for action in self._actions for option in action.option_strings]

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = [str(choice) for choice in action.choices]
            what = f"no {value!r}; there are {', '.join(known)}{suggest(str(value), known)}"
            raise argparse.ArgumentError(action, what)


def seconds(text: str) -> float:
    """A time of 0 s or more. Raises ArgumentTypeError for anything else, inf and nan among it."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"a number of seconds, 0 or more, not {text}")
    return value
