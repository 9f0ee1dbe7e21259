"""What can happen to a command from its first import to its last line, and its exit code.

Ctrl-C and SIGTERM end it with one line and 130; standard streams may be closed.

This module imports nothing heavy, as it comes before everything else.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

INTERRUPTED = 130  # what a shell reports of a program that SIGINT ended
CLOSED_PIPE = 141  # ... that SIGPIPE ended
_COMMANDS = {"snake_env", "evaluate", "train", "agents"}
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SAME_S = 0.05  # a terminal, make and a worker may all pass on the same Ctrl-C
_INSISTING = 3  # this many more of them end even the clean-up


def start() -> None:
    """Ends ``python -m`` one of our commands quietly where it is interrupted before it has begun."""
    words = sys.orig_argv
    here = Path(__file__).resolve().parents[2]
    modules = [b if a == "-m" else a[2:] for a, b in zip(words, [*words[1:], ""], strict=True)
               if a.startswith("-m")]  # fmt: skip
    is_command = sys.argv[:1] == ["-m"] and bool(modules)  # so it is while packages are imported
    name = modules[0].split(".")[0] if is_command else ""
    file = getattr(sys.modules.get(name), "__file__", None)
    is_ours = name in _COMMANDS and file and Path(file).resolve().parents[1] == here
    if is_ours:  # and no other package called "train"
        _install(_end_at_once)


def leave(code: int) -> NoReturn:
    """Ends the process; an interrupt while it does changes nothing any more.

    Handlers in Python would not do: the interpreter takes them away before it has ended.
    """
    _install(signal.SIG_IGN)
    sys.exit(code)


def guarded(command: Callable[[], int], interrupted: Callable[[], int]) -> int:
    """Runs a command in which Ctrl-C and SIGTERM raise KeyboardInterrupt.

    Args:
        command: Its result is the exit code.
        interrupted: What is done, and the exit code, where KeyboardInterrupt came out of it.
    """
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    _state.settled, _state.raised_at = False, float("-inf")
    try:
        _install(_raise)
        code = command()
    except KeyboardInterrupt:
        settle()
        code = interrupted()
    finally:
        settle()
        for number, handler in before.items():
            _install(handler, number)
    return code


def settle() -> None:
    """From here to the end of the command, interrupts are ignored: results are being written."""
    _state.settled = True
    _state.ignored = 0


@contextlib.contextmanager
def children_ignore() -> Iterator[None]:
    """Processes that are started in here never see Ctrl-C: their parent ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # children inherit the mask
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _State:
    """What interrupts meet: a command, or one that is putting things in order."""

    settled = True
    ignored = 0
    raised_at = float("-inf")


_state = _State()


def _raise(number: int, frame: FrameType | None) -> None:
    now = time.monotonic()
    if _state.settled:
        _state.ignored += 1
        if _state.ignored > _INSISTING:
            os._exit(INTERRUPTED)
    elif now - _state.raised_at > _SAME_S:
        _state.raised_at = now
        raise KeyboardInterrupt


def _end_at_once(number: int, frame: FrameType | None) -> None:
    with contextlib.suppress(OSError):
        os.write(2, b"interrupted\n")
    os._exit(INTERRUPTED)


def _install(handler: Any, *numbers: int) -> None:
    """Lets a handler take some signals, or both: only the main thread may say."""
    if threading.current_thread() is threading.main_thread():
        for number in numbers or _SIGNALS:
            signal.signal(number, handler)


def open_streams() -> None:
    """Gives a command that was started without standard streams (``>&-``) some that lead nowhere.

    Otherwise the next file that is opened would take their numbers, and what is printed would go there.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # whatever the terminal's alphabet is


def forget_stdout() -> None:
    """Lets what can't be printed any more vanish; Python would try it once more at its end."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
