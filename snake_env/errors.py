"""Typed errors: each names the field, the value and what would be right, on one line."""

from __future__ import annotations

import difflib
import math
import operator
from collections.abc import Iterable
from typing import Any

import numpy as np


class SnakeEnvError(Exception):
    """Base of the errors that this package raises about its input."""


class InvalidInputError(SnakeEnvError, ValueError):
    """A value that can't be used.

    Attributes:
        field: Name of the field or argument.
        value: What was given.
        expected: What would be right.
    """

    def __init__(self, field: str, value: Any, expected: str) -> None:
        super().__init__(field, value, expected)
        self.field, self.value, self.expected = field, value, expected

    def __str__(self) -> str:
        shown = " ".join(repr(self.value).split())
        if len(shown) > 80:
            shown = f"{shown[:38]}...{shown[-39:]}"
        return f"{self.field} = {shown}: expected {self.expected}"


class UnknownNameError(SnakeEnvError, LookupError):
    """A name that is not in a list of known ones; the message suggests the nearest.

    Attributes:
        kind: What was looked up: ``preset``, ``policy``, ...
        name: The name given.
        known: The names that exist.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, sorted(known)
        super().__init__(kind, name, self.known)

    def __str__(self) -> str:
        near = difflib.get_close_matches(str(self.name), self.known, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        return f"unknown {self.kind} {self.name!r}: {hint}known: {', '.join(self.known)}"


def as_integer(value: Any) -> int | None:
    """The value as a plain integer; None if it is none (floats, texts and truth values are not)."""
    if isinstance(value, (bool, np.bool_)):
        return None
    try:
        return operator.index(value)
    except TypeError:
        return None


def as_finite(value: Any) -> float | None:
    """The value as a float; None if it is no finite number (texts and truth values are none)."""
    if isinstance(value, (bool, np.bool_, str, bytes)):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


class InvalidModeError(InvalidInputError):
    """A mode that is out of range or not valid in the state's phase."""


class MissingDependencyError(SnakeEnvError, ImportError):
    """An optional package is needed; the message names the command that installs it."""
