"""``agents.value``: what states are worth to a greedy player."""

import dataclasses

import numpy as np
import pytest
import torch

from agents.failures import failure_cost
from agents.returns import Play, Returns, play
from agents.value import Fit, fit
from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.policies.one_step import ValuePolicy
from snake_env.policies.value import PhaseValue
from snake_env.sim.observation import observe
from snake_env.sim.simulation import advance
from snake_env.sim.tasks import random_tasks
from snake_env.state import SnakeState, StateBatch
from tests.support.robots import FIVE

FAILURE = failure_cost(FIVE)
SHARD = Play(seed=3, generation=1, part=2, count=64, network=None, trace_decay=1.0, params=FIVE)


def _starts() -> list[SnakeState]:
    streams = [np.random.SeedSequence(3, spawn_key=(1, 2, k)) for k in range(SHARD.count)]
    phi0, target = random_tasks([np.random.default_rng(stream) for stream in streams], FIVE)
    batch = StateBatch.initial(phi0, target, FIVE)
    return [batch[k] for k in range(len(batch))]


def _of(returns: Returns, state: SnakeState) -> float | None:
    """What the returns say about a state; None: they don't know it."""
    observation = observe(StateBatch.stack([state]), FIVE)[0]
    (rows,) = np.nonzero((returns.observations == observation).all(axis=1))
    return float(returns.intervals[rows[0]]) if len(rows) else None


def _greedy(state: SnakeState) -> SnakeState | None:
    """Where the policy of that value goes, which leaves modes that lead nowhere; None in a deadlock."""
    mode = ValuePolicy(FIVE, PhaseValue(FIVE)).select_mode(state)
    after, prediction = advance(state, mode, FIVE)
    return after if prediction.feasible[0] else None


def _needed(state: SnakeState) -> float:
    """Intervals that the greedy policy needs from a state."""
    for interval in range(int(FAILURE)):
        if state.done:
            return interval
        after = _greedy(state)
        if after is None:
            return FAILURE
        state = after
    return float(FAILURE)


def test_play__counts_the_intervals_of_greedy_play() -> None:
    returns = play(SHARD)
    known = [(state, _of(returns, state)) for state in _starts()]
    strict = [(state, intervals) for state, intervals in known if intervals is not None]
    # who explores is somewhere else when it begins to count
    assert len(strict) == returns.strict >= 3
    needed = [_needed(state) for state, _ in strict]
    assert needed == [intervals for _, intervals in strict]
    solved = [intervals for intervals in needed if intervals < FAILURE]
    assert (returns.solved, returns.time) == (len(solved), sum(solved))
    assert len(returns.observations) > returns.strict


def test_play__trusts_the_value_for_what_lies_ahead() -> None:
    exact = play(SHARD)
    trusting = play(dataclasses.replace(SHARD, trace_decay=0.75))
    np.testing.assert_array_equal(trusting.observations, exact.observations)
    value = PhaseValue(FIVE)
    checked = 0
    for state in _starts():
        wanted = _of(trusting, state)
        if wanted is None or _needed(state) == FAILURE:
            continue
        worths = []
        while not state.done:
            after = _greedy(state)
            assert after is not None
            state = after
            worths.append(float(value(StateBatch.stack([state]))[0]))
        # the weighted mean of the n-step returns (Sutton and Barto, 12.2)
        n_step = [n + worth for n, worth in enumerate(worths, start=1)]
        weights = [0.25 * 0.75 ** (n - 1) for n in range(1, len(worths))]
        weights.append(0.75 ** (len(worths) - 1))
        assert sum(weights) == pytest.approx(1.0)
        assert wanted == pytest.approx(float(np.dot(weights, n_step)), abs=1e-5)
        checked += 1
    assert checked >= 3


def test_fit__learns_its_returns_from_where_it_begins() -> None:
    returns = play(SHARD)
    data = (returns.observations, returns.intervals)
    how = Fit(hidden=(32,), epochs=80, batch_size=64, weight_decay=0.0)
    network, error = fit(None, *data, how, 1e-2, 5, seed=0)
    _, further = fit(network, *data, dataclasses.replace(how, epochs=1), 1e-6, 5, seed=1)
    assert error < 0.5 * np.abs(returns.intervals - np.median(returns.intervals)).mean()
    assert further == pytest.approx(error, rel=0.5)


def test_fit__says_where_it_can_be_done() -> None:
    with pytest.raises(UnknownNameError, match=r"device"):
        Fit(device="tpu").check()
    if not torch.cuda.is_available():
        with pytest.raises(InvalidInputError, match=r"^device = 'cuda': expected cpu"):
            Fit(device="cuda").check()
