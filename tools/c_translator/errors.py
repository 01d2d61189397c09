"""Errors of the translator: constructs that have no translation."""

from __future__ import annotations


class Refused(Exception):
    """Refusal of a construct, with the reason as text; without text its kind is the reason."""


class NotInSubsetError(Exception):
    """Construct without a translation, with its file and line."""
