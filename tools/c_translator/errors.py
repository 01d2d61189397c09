"""What is said of a construct without a translation."""

from __future__ import annotations


class Refused(Exception):
    """Why there is no translation; without text, because of what the construct is."""


class NotInSubsetError(Exception):
    """A construct without a translation, and where it is."""
