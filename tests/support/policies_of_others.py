"""Policies such as people bring along, good and bad, for ``--policy``."""

from __future__ import annotations

import time
from typing import Any

from snake_env.params import SnakeParams
from snake_env.policies.registry import FirstFeasiblePolicy
from snake_env.state import SnakeState

NOT_CALLABLE = 3


class Sleepy(FirstFeasiblePolicy):
    """Never decides in phase 1 of the tasks 1 and 3, and swallows what might wake it."""

    task: int | None = None

    def reset(self, seed: int | None = None) -> None:
        self.task = seed

    def select_mode(self, state: SnakeState) -> int:
        while self.task in (1, 3):
            try:
                time.sleep(1.0)
            except Exception:
                continue
        return super().select_mode(state)


class Wrong(FirstFeasiblePolicy):
    """Chooses a mode that there is not."""

    def select_mode(self, state: SnakeState) -> Any:
        return 4711


class Leaving(FirstFeasiblePolicy):
    """Ends the process, as scripts do."""

    def select_mode(self, state: SnakeState) -> int:
        raise SystemExit("bye")


def no_policy(params: SnakeParams) -> object:
    return object()


def uncounted(params: SnakeParams) -> object:
    policy = FirstFeasiblePolicy(params)
    policy.rollouts = None  # type: ignore[assignment]
    return policy


def failing(params: SnakeParams) -> object:
    raise RuntimeError("no\nweights")
