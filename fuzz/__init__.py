"""Hostile input for every reader of the project: `scripts/fuzz`, and the tests of tests/fuzz over the same table.

    table.py      THE table: every reader, from the rooms below
    wire.py files.py kept.py page.py words.py      readers, by what they read
    reader.py     what a row is                   mutating.py   changes that keep a text, a tree or a frame nearly right
    campaign.py   one reader under atheris        corpus.py     inputs that are kept, and which of them are worth it
    __main__.py   the command

Rules: a reader here is the real one, called as the program calls it; what it may raise is what its docstring says, and
anything else is a finding. Nothing of the packages imports this.
"""
