"""Typed errors: each names the field, the value and what would be right, on one line."""

from __future__ import annotations

import difflib
import math
import operator
import reprlib
import unicodedata
from collections.abc import Iterable
from typing import Any

import numpy as np

_LONGEST_VALUE = 80  # characters of a value in a message
_CONTROLS = ("Cc", "Cf", "Cs", "Zl", "Zp")  # controls, invisible ones, halves of pairs, line ends


def escaped(text: str) -> str:
    """The text with escapes for what a terminal obeys or can't show, except for line ends."""
    return "".join(
        char.encode("unicode_escape").decode()
        if unicodedata.category(char) in _CONTROLS and char != "\n"
        else char
        for char in text
    )


def printable(text: str) -> str:
    """The text, escaped and on one line."""
    return escaped(" ".join(text.split()))


class _Shown(reprlib.Repr):
    """A ``repr`` whose length and depth have a bound, whatever it is asked about."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 3
        self.maxstring = self.maxother = self.maxlong = 4 * _LONGEST_VALUE
        self.maxtuple = self.maxlist = self.maxdict = self.maxset = self.maxfrozenset = 40

    def repr_int(self, value: int, level: int) -> str:
        if value.bit_length() > 1000:  # Python refuses to print thousands of digits
            return f"<an integer of {value.bit_length()} bits>"
        return repr(value)


def _shown(value: Any) -> str:
    shown = printable(_Shown().repr(value))
    return shown if len(shown) <= _LONGEST_VALUE else f"{shown[:38]}...{shown[-39:]}"


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
        return printable(f"{self.field} = {_shown(self.value)}: expected {self.expected}")


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
        close = isinstance(self.name, str) and len(self.name) <= _LONGEST_VALUE
        near = difflib.get_close_matches(self.name, self.known, n=1) if close else ()
        hint = f"did you mean {near[0]!r}? " if near else ""
        known = ", ".join(map(str, self.known))
        return printable(f"unknown {self.kind} {_shown(self.name)}: {hint}known: {known}")


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
