"""Policies such as people bring along, good and bad, for ``--policy``."""

from __future__ import annotations

import os
import time
from typing import Any, ClassVar

from snake_env.params import SnakeParams
from snake_env.policies.baselines import AnalyticPolicy, FirstFeasiblePolicy
from snake_env.state import SnakeState
from tests.support import HANGS_S

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


def with_texts(params: SnakeParams) -> object:
    policy = FirstFeasiblePolicy(params)
    policy.models = ["a", "b"]  # type: ignore[attr-defined]
    return policy


def with_none(params: SnakeParams) -> object:
    policy = FirstFeasiblePolicy(params)
    policy.models = None  # type: ignore[attr-defined]
    return policy


def failing(params: SnakeParams) -> object:
    raise RuntimeError("no\nweights")


class Wandering(FirstFeasiblePolicy):
    """Changes the folder that relative paths begin in, and never comes back."""

    def select_mode(self, state: SnakeState) -> int:
        os.chdir("/")
        return super().select_mode(state)


def wanderer(params: SnakeParams) -> Wandering:
    os.chdir("/")
    return Wandering(params)


class Halting(AnalyticPolicy):
    """(21); where the environment says so, it stands still at the tasks from 60 on."""

    def reset(self, seed: int | None = None) -> None:
        if seed is not None and seed >= 60 and "HALT" in os.environ:
            time.sleep(HANGS_S)
        super().reset(seed)


class OutsideSuite(FirstFeasiblePolicy):
    """Decides at once in a suite's tasks, and never in those that only pictures show."""

    endings: ClassVar[list[str]] = []
    """What ended the decisions that are never made."""

    def select_mode(self, state: SnakeState) -> int:
        try:
            while abs(state.target[0] - 0.29) < 1e-9:  # simulation 1
                time.sleep(0.1)
        except BaseException as end:
            self.endings.append(type(end).__name__)
            raise
        return super().select_mode(state)


class Screaming(FirstFeasiblePolicy):
    """Fails with a text that a terminal would obey."""

    def select_mode(self, state: SnakeState) -> int:
        raise RuntimeError("\x1b[2J\x1b]0;mine\x07 [red]no[/blue] \udcff\u202e")


class Unprintable(FirstFeasiblePolicy):
    """Fails with an exception that has no text."""

    def select_mode(self, state: SnakeState) -> int:
        class SilentError(Exception):
            def __str__(self) -> str:
                raise ValueError("no text")

        raise SilentError


class Forgetful(FirstFeasiblePolicy):
    """Loses count of its roll-outs."""

    def select_mode(self, state: SnakeState) -> int:
        mode = super().select_mode(state)
        self.rollouts = None  # type: ignore[assignment]
        return mode


class PerEpisode(AnalyticPolicy):
    """Counts its roll-outs from 0 in each episode."""

    def reset(self, seed: int | None = None) -> None:
        self.rollouts = 0


class Countless(FirstFeasiblePolicy):
    """Has counted more than there can be."""

    def select_mode(self, state: SnakeState) -> int:
        self.rollouts = 2**62
        return super().select_mode(state)


class CountingDown(FirstFeasiblePolicy):
    """Counts down within an episode."""

    def select_mode(self, state: SnakeState) -> int:
        self.rollouts -= 100
        return super().select_mode(state)
