"""Generate the notebooks of the course from their sources, and run them with the solutions.

    docs/course/source/01-encoders.py       cells in percent format (jupytext), with tasks to be written
    docs/course/01-encoders.ipynb           the student's notebook: `python -m docs.generate`
    docs/course/solutions/01-encoders.py    the functions that solve the tasks

    python -m docs.generate.course [--quick] [--replay] [NAME...]    run in Jupyter, with the solutions in
    python -m docs.generate.course --grade                           grade a class of 33 submissions

A number with a comment `# quick: N` has that value in short runs.
"""

from __future__ import annotations

import ast
import base64
import json
import re
import subprocess
import sys
import tempfile
import time
from io import BytesIO
from pathlib import Path
from typing import Any, Final

from PIL import Image

ROOT: Final = Path(__file__).parents[2]
COURSE: Final = ROOT / "docs" / "course"
NAMES: Final = tuple(sorted(path.stem for path in (COURSE / "source").glob("*.py")))
QUICK: Final = re.compile(r"= (.+?)(\s+# quick: )(.+)$", re.MULTILINE)
KERNEL: Final = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}
SHOWN: Final = COURSE / "pictures"
"""One picture of each notebook, for docs/course.md."""
SHOWN_NUMBER: Final = {"06-ekf-room": 1}
"""Number of the picture that is shown of a notebook; else its first."""
TIMEOUT_S: Final = 300
"""For one cell, on a busy machine."""


def notebook(name: str) -> Any:
    """Return a notebook: cells of the source, with fixed ids and without outputs."""
    import jupytext

    source = (COURSE / "source" / f"{name}.py").read_text(encoding="utf-8")
    made = jupytext.reads(source, fmt="py:percent")
    for number, cell in enumerate(made.cells):
        cell["id"] = f"cell-{number}"
        # Numbers of short runs are for the tests.
        cell["source"] = re.sub(r"\s+# quick: .*$", "", cell["source"], flags=re.MULTILINE)
        cell["metadata"] = {key: value for key, value in cell["metadata"].items() if key == "tags"}
    made.metadata.clear()
    made.metadata.update(KERNEL)
    return made


def text(name: str) -> str:
    """Return the file of a notebook."""
    import jupytext

    return str(jupytext.writes(notebook(name), fmt="ipynb")) + "\n"


def solved(name: str, *, quick: bool = False, address: str = "") -> Any:
    """Return a notebook with the solutions in its tasks, and with another address if one is given."""
    import jupytext

    made = jupytext.reads((COURSE / "source" / f"{name}.py").read_text(encoding="utf-8"), fmt="py:percent")
    solution = (COURSE / "solutions" / f"{name}.py").read_text(encoding="utf-8")
    functions = {node.name: ast.get_source_segment(solution, node) for node in ast.parse(solution).body
                 if isinstance(node, ast.FunctionDef)}  # fmt: skip
    for cell in made.cells:
        tags = cell.metadata.get("tags", [])
        if "task" in tags:
            (stub,) = ast.parse(cell.source).body
            assert isinstance(stub, ast.FunctionDef)
            cell.source = functions[stub.name]
        if "parameters" in tags:
            cell.source = QUICK.sub(r"= \3", cell.source) if quick else cell.source
            if address:
                cell.source += f"\nADDRESS = {address!r}"
    made.metadata.clear()
    made.metadata.update(KERNEL)
    return made


def address_of(name: str) -> str:
    """Return the address in the parameters of a notebook."""
    source = (COURSE / "source" / f"{name}.py").read_text(encoding="utf-8")
    found = re.search(r'^ADDRESS = "(.*)"', source, re.MULTILINE)
    assert found
    return found[1]


def run(made: Any, folder: Path) -> Any:
    """Execute a notebook in a kernel, with this working folder; raise if a cell fails or an answer is wrong."""
    from nbclient import NotebookClient

    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(made, timeout=TIMEOUT_S, kernel_name="python3", resources=resources).execute()
    outputs = [output for cell in made.cells for output in cell.get("outputs", ())]
    shown = "\n".join(str(output.get("text", output.get("data", {}).get("text/plain", ""))) for output in outputs)
    assert "not yet" not in shown, shown
    return made


def pictures(made: Any) -> list[bytes]:
    """Return the pictures of an executed notebook."""
    return [base64.b64decode(output["data"]["image/png"]) for cell in made.cells for output in cell.get("outputs", ())
            if "image/png" in output.get("data", {})]  # fmt: skip


def write_pictures(name: str, found: list[bytes], folder: Path) -> None:
    """Write pictures of a notebook with few colours, so that they are small."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, picture in enumerate(found):
        if folder == SHOWN and number != SHOWN_NUMBER.get(name, 0):
            continue
        file = folder / (f"{name}.png" if folder == SHOWN else f"{name}-{number}.png")
        Image.open(BytesIO(picture)).convert("RGB").quantize(64).save(file, optimize=True)


def grade_class() -> None:
    """Grade three submissions of each notebook: with the solutions, without, and the solutions as a file."""
    import jupytext

    with tempfile.TemporaryDirectory() as folder:
        for name in NAMES:
            jupytext.write(solved(name), f"{folder}/{name}-solved.ipynb")
            Path(folder, f"{name}-unsolved.ipynb").write_text(text(name), encoding="utf-8")
        words = ["grade", folder, *map(str, sorted((COURSE / "solutions").glob("*.py"))), "--json"]
        begin = time.perf_counter()
        done = subprocess.run([Path(sys.executable).with_name("nomad"), *words], stdout=subprocess.PIPE, check=True)
    submissions = json.loads(done.stdout)["submissions"]
    for each in submissions:
        expected = 0 if each["file"].endswith("-unsolved.ipynb") else each["of"]
        assert each["points"] == expected, each
        assert each["of"] > 0, each
    print(f"{len(submissions)} submissions graded in {time.perf_counter() - begin:.0f} s")


def main(words: list[str]) -> None:
    """Run notebooks with the solutions in and store their pictures in out/course, or grade a class.

    With --shown, one picture of each goes to docs/course/pictures instead, for the page.
    """
    if "--grade" in words:
        grade_class()
        return
    quick, replay = "--quick" in words, "--replay" in words
    for name in [word for word in words if not word.startswith("--")] or NAMES:
        begin = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            # A recording of the notebook's own drive takes the place of the robot.
            log = Path(folder) / "drive.log"
            address = f"{address_of(name)}&record={log}" if replay else ""
            done = run(solved(name, quick=quick, address=address), Path(folder))
            if replay:
                run(solved(name, quick=quick, address=f"replay:{log}"), Path(folder))
            write_pictures(name, pictures(done), SHOWN if "--shown" in words else ROOT / "out" / "course")
        print(f"{name}: {time.perf_counter() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
