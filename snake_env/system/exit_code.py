"""How a command ends: an exit code, and one line where something went wrong."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable

from snake_env.errors import SnakeEnvError, printable
from snake_env.system import interrupts


def complain(text: str) -> None:
    """Says in one line what is wrong."""
    print(printable(text), file=sys.stderr, flush=True)


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
        with contextlib.suppress(OSError):  # what was printed before
            sys.stdout.flush()
        interrupts.forget_stdout()
        complain(f"error: {error}")
        return 1
