"""How a command speaks and how it ends."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable

from rich.console import Console

from snake_env import interrupts
from snake_env.errors import SnakeEnvError

CLOSED_PIPE = 141  # what a shell reports of a program that SIGPIPE ended


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Leaves it to :func:`exit_code`; rich itself ends with 1."""
        raise


def console() -> Console:
    """Where results are printed: 100 columns where there is no terminal."""
    return _Console(width=None if sys.stdout.isatty() else 100, highlight=False, emoji=False)


def exit_code(command: Callable[[], int], interrupted: str = "interrupted") -> int:
    """Runs a command; what goes wrong becomes one line and an exit code.

    Args:
        command: Its result is its exit code.
        interrupted: What is printed when Ctrl-C or SIGTERM ends it.

    Returns:
        The command's own exit code; 2: it was given something that it can't use; 1: the system refused
        something; 130: interrupted; 141: whoever read the output has gone.
    """

    def told() -> int:
        print(interrupted, file=sys.stderr)
        return interrupts.INTERRUPTED

    return interrupts.guarded(lambda: _without_traceback(command), told)


def _without_traceback(command: Callable[[], int]) -> int:
    try:
        code = command()
        sys.stdout.flush()
        return code
    except SnakeEnvError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        _forget_stdout()
        return CLOSED_PIPE
    except OSError as error:
        _forget_stdout()
        print(f"error: {error}", file=sys.stderr)
        return 1


def _forget_stdout() -> None:
    """Lets what can't be printed any more vanish; Python would try it once more at its end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
