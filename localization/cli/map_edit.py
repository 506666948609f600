"""`nomad map edit`: adjust a learned map to lengths that were measured with a tape, and name its walls."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from localization.cli import arguments
from localization.mapping.adjust import TAPE_STD_IN, Adjustment, TapeLength, adjust_walls, label_walls
from nclient.common.arguments import add_flag, add_value
from nclient.common.files import write_errors_as
from nclient.errors import OutputFileError
from worlds.io import format_world, load_world, parse_world
from worlds.world import Point


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `nomad map edit`."""
    parser.description = (
        "Adjust a learned map to lengths that were measured with a tape: its walls move by least squares, each "
        "according to its standard deviation in the file. Name walls."
    )
    parser.set_defaults(refuse=parser.error)
    parser.epilog = "example: nomad map edit room.toml --length 0,0 114.2,0 114.6 --out better.toml"
    parser.add_argument("world", metavar="WORLD", help="map: a world file of nomad map learn")
    parser.add_argument(
        "--length", action="append", nargs=3, default=[], metavar=("X,Y", "X,Y", "IN"), dest="lengths",
        help="the distance of two ends of walls, given by points near them, in in; repeatable; give "
             "all lengths of a map at once, so that each counts once",
    )  # fmt: skip
    parser.add_argument(
        "--label", action="append", nargs=2, default=[], metavar=("X,Y", "NAME"), dest="labels",
        help="the name of the wall nearest to a point, within 6 in; an empty one removes it; repeatable",
    )  # fmt: skip
    add_value(parser, "--tape-std", "IN", arguments.parse_positive,
              "standard deviation of the measured lengths in inches", TAPE_STD_IN)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="write this world file")
    add_flag(parser, "--json", "print only the result, as JSON, on stdout")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    # 1. Report wrong lengths and an unwritable file before the work.
    tapes = [_tape_length(words, options) for words in options.lengths]
    labels = [_label(words, options) for words in options.labels]
    if not tapes and not labels:
        options.refuse("nothing to change: give --length or --label")
    arguments.check_writable(options.out)
    world = load_world(options.world)
    named = label_walls(world, labels)
    found = adjust_walls(named, tapes) if tapes else Adjustment(named, 0.0, ())
    # 2. The file states how it was made. Reading it again checks that its starts are still in free space.
    changes = [f"{tape.length_in:g} in" for tape in tapes] + [f"label {name!r}" for _, name in labels]
    text = format_world(found.world, f"nomad map edit {Path(options.world).name}: {', '.join(changes)}")
    parse_world(text, str(options.out), world.name)
    with write_errors_as(OutputFileError, options.out):
        options.out.write_text(text, encoding="utf-8")
    print(json.dumps(as_json(found)) if options.json else _summary(found, tapes, options.out))
    return 0


def as_json(found: Adjustment) -> dict[str, object]:
    """Return the result as plain data."""
    return {"moved_in": found.moved_in, "residuals_in": list(found.residuals_in)}


def _label(words: list[str], options: argparse.Namespace) -> tuple[Point, str]:
    try:
        return arguments.parse_point(words[0]), words[1].strip()
    except (ValueError, argparse.ArgumentTypeError) as error:
        options.refuse(f"--label {' '.join(words)}: {error}")
        raise


def _tape_length(words: list[str], options: argparse.Namespace) -> TapeLength:
    first, second, length = words
    try:
        ends = arguments.parse_point(first), arguments.parse_point(second)
        return TapeLength(ends, arguments.parse_positive(length), options.tape_std)
    except (ValueError, argparse.ArgumentTypeError) as error:
        options.refuse(f"--length {' '.join(words)}: {error}")
        raise


def _summary(found: Adjustment, tapes: list[TapeLength], out: Path) -> str:
    lines = [
        f"{tape.length_in:g} in: {tape.length_in + residual:.2f} in the map now"
        for tape, residual in zip(tapes, found.residuals_in, strict=True)
    ]
    moved = f"ends moved by at most {found.moved_in:.2f} in: {out}" if tapes else str(out)
    return "\n".join([*lines, moved])
