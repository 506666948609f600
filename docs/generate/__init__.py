"""Generators of reference pages. They read the tables of the packages and are not part of the wheel.

    python -m docs.generate      writes all of them (scripts/reference-pages)
"""
