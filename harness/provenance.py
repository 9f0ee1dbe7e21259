"""Provenance: the command line and the revision that made a result, as its records name them."""

from __future__ import annotations

import shlex
import subprocess
from collections.abc import Sequence
from pathlib import Path

_words: list[str] = []
_FLAGS, _VALUED = ("--resume", "--overwrite"), ("--out", "--workers", "--engine", "--address")


def begin(program: str, words: Sequence[str]) -> None:
    """Records the command line that results will name.

    Args:
        program: How the command is called, such as ``python -m train``.
        words: Its arguments.
    """
    _words[:] = [program, *words]


def arguments() -> list[str]:
    """The recorded arguments, for a command that others are parts of."""
    return _words[1:]


def command() -> str:
    """The recorded command line, without what has no influence on results.

    That is where they go, what was there before, and who does the work.
    """
    program, *words = _words or [""]
    kept = [word for word in words_without(words, *_VALUED) if word not in _FLAGS]
    return f"{program} {shlex.join(kept)}"


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


def revision() -> str | None:
    """The checkout's revision, with a + where files have changed since; None outside of a checkout."""
    here = Path(__file__).parent
    try:
        commit, changes = (
            subprocess.run(
                ["git", *words], cwd=here, capture_output=True, text=True, check=True
            ).stdout.strip()
            for words in (("rev-parse", "HEAD"), ("status", "--porcelain", "-uno"))
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return commit + ("+" if changes else "")
