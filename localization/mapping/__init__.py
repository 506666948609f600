"""Evaluation of maps for localization."""
