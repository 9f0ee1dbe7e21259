"""How a command speaks and how it ends."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from rich.console import Console
from rich.text import Text

from snake_env import interrupts
from snake_env.errors import SnakeEnvError, escaped, printable


class PlainConsole(Console):
    """Prints texts as they are: a name or a path is no markup, and a terminal obeys nothing in it."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, emoji=False, markup=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """A text as what is printed."""
        return super().render_str(escaped(text), **options)

    def on_broken_pipe(self) -> None:
        """Leaves it to :func:`exit_code`; rich itself ends with 1."""
        raise


def console(*, error: bool = False) -> PlainConsole:
    """Where results are printed, or with ``error`` the rest: 100 columns where there is no terminal."""
    stream = sys.stderr if error else sys.stdout
    return PlainConsole(width=None if stream.isatty() else 100, stderr=error)


def complain(text: str) -> None:
    """Says in one line what is wrong."""
    print(printable(text), file=sys.stderr, flush=True)


def in_one_line(problem: BaseException) -> str:
    """An exception's type and message."""
    try:
        return printable(f"{type(problem).__name__}: {problem}")
    except Exception:  # its text is its author's
        return type(problem).__name__


def exit_code(command: Callable[[], int], interrupted: str = "interrupted") -> int:
    """Runs a command; what goes wrong becomes one line and an exit code.

    Args:
        command: Its result is its exit code.
        interrupted: What is printed when Ctrl-C or SIGTERM ends it.

    Returns:
        The command's own exit code; 2: it was given something that it can't use; 1: the system refused
        something; 130: interrupted; 141: whoever read the output has gone.
    """
    interrupts.open_streams()

    def on_interrupt() -> int:
        complain(interrupted)
        return interrupts.INTERRUPTED

    return interrupts.guarded(lambda: _without_traceback(command), on_interrupt)


def _without_traceback(command: Callable[[], int]) -> int:
    try:
        code = command()
        sys.stdout.flush()
        return code
    except SnakeEnvError as error:
        complain(f"error: {error}")
        return 2
    except BrokenPipeError:
        interrupts.forget_stdout()
        return interrupts.CLOSED_PIPE
    except MemoryError as error:
        complain(
            f"error: out of memory ({error or 'none is left'}): use fewer workers or smaller batches"
        )
        return 1
    except OSError as error:
        interrupts.forget_stdout()
        complain(f"error: {error}")
        return 1
