"""The report of a shadow as a file: JSON, or CSV where the file is called so; a row a quantity."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Final

from nclient.errors import RecordingError
from nclient.unwritable import unwritable
from nserver_emu.gateway.shadow import Shadow

_COLUMNS: Final = ("count", "mean", "std", "max", "last", "one_sided")


def write(shadow: Shadow, address: str, path: Path) -> None:
    """Write the report. Raises RecordingError where the file cannot be written."""
    text = as_csv(shadow) if path.suffix.lower() == ".csv" else as_json(shadow, address)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise RecordingError(unwritable(path, error, "the report of the shadow")) from error


def as_json(shadow: Shadow, address: str) -> str:
    """Address, model, how many states were compared, and the quantities by name."""
    whole = {
        "robot": address,
        "model": shadow.model.name,
        "states": shadow.states,
        "difference": "real less simulated",
        "quantities": {name: found.as_numbers() for name, found in shadow.quantities.items()},
    }
    return json.dumps(whole, indent=2) + "\n"


def as_csv(shadow: Shadow) -> str:
    """The quantities, a row each, under a row of names."""
    text = io.StringIO()
    rows = csv.DictWriter(text, ("quantity", *_COLUMNS), lineterminator="\n")
    rows.writeheader()
    for name, found in shadow.quantities.items():
        rows.writerow({"quantity": name, **found.as_numbers()})
    return text.getvalue()
