"""A limit to how long a policy may think about a decision."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import Any, TypeVar

from snake_env.errors import InvalidInputError

T = TypeVar("T")

_AGAIN_S = 1.0  # code that swallows the exception gets it once more
_LONGEST_S = 1e6


class DecisionTimeoutError(BaseException):
    """A decision took too long. Not an ``Exception``, as a policy may swallow these."""


def check_limit(seconds: float) -> None:
    """Checks whether decisions can be limited to a time [s].

    Raises:
        InvalidInputError: It is no duration, or the system has no timers.
    """
    if not 0.0 < seconds <= _LONGEST_S:
        expected = f"seconds, more than 0 and at most {_LONGEST_S:.0f}"
        raise InvalidInputError("decision_timeout", seconds, expected)
    if not hasattr(signal, "setitimer"):
        raise InvalidInputError("decision_timeout", seconds, "a system with signal.setitimer")


def with_timeout(seconds: float | None, call: Callable[..., T], *args: Any) -> T:
    """Calls a function, and raises in it when the time is over.

    Python looks for signals between its own instructions: what never comes back from compiled code
    can't be interrupted.

    Args:
        seconds: The limit [s]; None: there is none.
        call: The function.
        *args: Its arguments.

    Raises:
        DecisionTimeoutError: It took longer.
    """
    if seconds is None:
        return call(*args)

    def expire(*_: Any) -> None:
        raise DecisionTimeoutError(f"no decision within {seconds:g} s")

    previous = signal.signal(signal.SIGALRM, expire)
    try:
        try:
            signal.setitimer(signal.ITIMER_REAL, seconds, _AGAIN_S)
            return call(*args)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:  # again: the alarm may have gone off before the line above
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)
