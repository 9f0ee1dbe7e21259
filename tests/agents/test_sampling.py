"""Which modes are tried in training: all, or a random choice of many."""

import numpy as np

from agents.sampling import MOST, sampled_modes
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.tasks import random_tasks
from snake_env.state import StateBatch

TEN = SnakeParams.preset("ten")


def _states(phases: list[int], params: SnakeParams) -> StateBatch:
    phi0, target = random_tasks([np.random.default_rng(k) for k in range(len(phases))], params)
    start = StateBatch.initial(phi0, target, params)
    return StateBatch(**{**vars(start), "phase": np.array(phases)})


def test_few_modes__are_all_tried() -> None:
    states = _states([4, 7, 10, 8], TEN)
    valid = mode_table(10).masks(states.phase)
    assert valid.sum(axis=1).max() <= MOST
    assert np.array_equal(sampled_modes(states, np.random.default_rng(0), TEN), valid)


def test_many_modes__are_tried_at_random_and_as_often() -> None:
    states = _states([1] * 400 + [6], TEN)
    valid = mode_table(10).masks(states.phase)
    tried = sampled_modes(states, np.random.default_rng(0), TEN)
    assert not (tried & ~valid).any()
    assert (tried[:400].sum(axis=1) == MOST).all()
    assert np.array_equal(tried[400], valid[400])
    share = tried[:400].mean(axis=0)[valid[0]]
    assert abs(share - MOST / valid[0].sum()).max() < 0.1  # each mode, four standard deviations


def test_wanted_mode__is_always_tried() -> None:
    states = _states([1] * 50, TEN)
    wanted = np.arange(50) * 9
    tried = sampled_modes(states, np.random.default_rng(1), TEN, also=wanted)
    assert tried[np.arange(50), wanted].all()
    assert (tried.sum(axis=1) == MOST).all()
