"""Provenance: the command line that made a result, as the result's records name it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

_words: list[str] = []


def begin(program: str, words: Sequence[str]) -> None:
    """Records the command line that results will name.

    Args:
        program: How the command is called, such as ``python -m train``.
        words: Its arguments.
    """
    _words[:] = [program, *words]


def command() -> str:
    """The recorded command line, without the folder of its results."""
    program, *words = _words or [""]
    return f"{program} {shlex.join(words_without(words, '--out'))}"


def words_without(words: Sequence[str], *options: str) -> list[str]:
    """A command line without some options and their values."""
    kept: list[str] = []
    skip = False
    for word in words:
        if skip or word.partition("=")[0] in options:
            skip = not skip and "=" not in word
        else:
            kept.append(word)
    return kept
