"""Fuzzing of every reader of outer input: `scripts/fuzz`, and tests/fuzz with the same table of readers.

    readers.py      the table of all readers
    wire.py text_files.py saved_files.py messages.py command_text.py      its rows, by what they read
    reader.py       what a row contains            mutation.py     mutations that keep an input nearly valid
    runner.py       runs one reader in a process   __main__.py     the command
    seeds/READER/   at most five named inputs per reader, beside those that the rows make themselves

A row calls the reader as the programs do. The exceptions in its row are the documented ones; any other is a finding.
"""
