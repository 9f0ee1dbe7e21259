"""Hypothesis' profile, and the fixtures of all tests."""

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import settings

from snake_env.sim.tasks import load_tasks
from snake_env.state import SnakeState
from tests.support.browser import chromium
from tests.support.robots import PAPER

settings.register_profile("suite", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("suite")


@pytest.fixture
def sim_1() -> SnakeState:
    """Where simulation 1 of the paper begins."""
    return load_tasks("sim-1", PAPER).initial(0, PAPER)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A Chromium."""
    with chromium() as started:
        yield started
