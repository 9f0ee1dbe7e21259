"""Policies of other people: ``module:factory``, beside those that ``load_policy`` knows."""

from __future__ import annotations

import importlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from harness.console import in_one_line
from snake_env.errors import InvalidInputError, as_integer
from snake_env.params import SnakeParams
from snake_env.policies.base import Policy
from snake_env.policies.registry import POLICIES, SHIELD, load_policy
from snake_env.policies.shield import ShieldedPolicy

_OUTSIDE = re.compile(r"([A-Za-z_][\w.]*):([A-Za-z_]\w*)")


def is_outside(name: str) -> bool:
    """Whether a name is ``module:factory``, with or without ``+shield``."""
    match = _OUTSIDE.fullmatch(name.removesuffix(SHIELD))
    return match is not None and match[1] not in POLICIES


def make_policy(name: str, params: SnakeParams) -> Policy:
    """A policy by any name that an evaluation takes.

    Args:
        name: What :func:`snake_env.load_policy` takes, or ``module:factory``: a module that Python
            finds, and what to call in it with the constants. ``+shield`` may follow.
        params: The constants.

    Raises:
        SnakeEnvError: There is no such policy; the module can't be imported; the factory fails or
            makes something else.
    """
    if not is_outside(name):
        return load_policy(name, params)
    if name.endswith(SHIELD):
        return ShieldedPolicy(make_policy(name.removesuffix(SHIELD), params), params)
    module, _, factory = name.partition(":")
    with staying():
        return _checked(name, _call(name, _import(name, module), factory, params))


@contextmanager
def staying() -> Iterator[None]:
    """Ends in the folder that it began in, wherever a policy has gone: relative paths begin there."""
    here = None
    with suppress(FileNotFoundError):  # the folder is gone
        here = os.getcwd()
    try:
        yield
    finally:
        if here is not None:
            os.chdir(here)


def _import(name: str, module: str) -> Any:
    try:
        return importlib.import_module(module)
    except (Exception, SystemExit) as problem:
        expected = f"a module that can be imported ({in_one_line(problem)})"
        raise InvalidInputError("policy", name, expected) from None


def _call(name: str, module: Any, factory: str, params: SnakeParams) -> Any:
    if not callable(getattr(module, factory, None)):
        expected = f"something in {module.__name__} that can be called"
        raise InvalidInputError("policy", name, expected)
    try:
        return getattr(module, factory)(params)
    except (Exception, SystemExit) as problem:
        expected = f"a factory that makes a policy for given constants ({in_one_line(problem)})"
        raise InvalidInputError("policy", name, expected) from None


def _checked(name: str, policy: Any) -> Policy:
    for method in ("reset", "select_mode"):
        if not callable(getattr(policy, method, None)):
            expected = f"a policy; a {type(policy).__name__} has no method {method}"
            raise InvalidInputError("policy", name, expected)
    if as_integer(getattr(policy, "rollouts", None)) is None:
        expected = f"a policy; a {type(policy).__name__} has no integer rollouts"
        raise InvalidInputError("policy", name, expected)
    return policy  # type: ignore[no-any-return]
