"""How a command speaks."""

from __future__ import annotations

import sys
from typing import Any

from rich.console import Console
from rich.text import Text

from snake_env.errors import escaped, printable


class PlainConsole(Console):
    """Prints texts as they are: a name or a path is no markup, and a terminal obeys nothing in it."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, emoji=False, markup=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """A text as what is printed."""
        return super().render_str(escaped(text), **options)

    def on_broken_pipe(self) -> None:
        """Leaves it to :func:`snake_env.system.exit_code.exit_code`; rich itself ends with 1."""
        raise


def console(*, error: bool = False) -> PlainConsole:
    """Where results are printed, or with ``error`` the rest: 100 columns where there is no terminal."""
    stream = sys.stderr if error else sys.stdout
    return PlainConsole(width=None if stream.isatty() else 100, stderr=error)


def in_one_line(problem: BaseException) -> str:
    """An exception's type and message."""
    try:
        return printable(f"{type(problem).__name__}: {problem}")
    except Exception:  # its text is its author's
        return type(problem).__name__
