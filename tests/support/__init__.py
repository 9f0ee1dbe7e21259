"""What the tests share."""

from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

ROOT = Path(__file__).resolve().parents[2]
"""The checkout."""

HANGS_S = 900.0
"""What takes longer than this hangs [s]: far more than any work here takes, on a busy machine too."""


def first(found: Iterable[T]) -> T:
    """The first that a search finds; a test that finds nothing fails."""
    for each in found:
        return each
    raise AssertionError("the search finds nothing")
