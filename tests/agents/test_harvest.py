"""Harvests: the tasks that a policy loses, and what lies around them."""

import dataclasses

import numpy as np
import pytest

from agents.harvest import Lost, Trial, around, play
from snake_env.modes import mode_table
from snake_env.networks.model_file import Model
from snake_env.networks.network import Network
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.sim.episode import STILL
from snake_env.sim.simulation import advance, least_distances, predict
from snake_env.sim.tasks import random_tasks
from snake_env.state import SnakeState
from tests.support.models import unsure
from tests.support.robots import PAPER

SHARD = Trial(seed=1, part=3, count=40, network=unsure(), params=PAPER)


def _is_lost(state: SnakeState, network: Network) -> bool:
    """Plays a task by itself."""
    policy = NetworkPolicy(PAPER, Model("policy", PAPER, network))
    for _ in range(PAPER.horizon):
        before, mode = state, policy.select_mode(state)
        state, prediction = advance(before, mode, PAPER)
        if not prediction.feasible[0] or prediction.d_min[0] < PAPER.d_touch:
            others = predict(before, mode_table(8).valid(before.phase), PAPER)
            return bool((others.feasible & (others.d_min >= PAPER.d_touch)).any())
        if state.done or np.abs(state.phi - before.phi).max() < STILL:
            return False
    return False


def _tasks(shard: Trial) -> tuple[np.ndarray, np.ndarray]:
    """All tasks of a shard."""
    rng = np.random.default_rng(np.random.SeedSequence(shard.seed, spawn_key=(shard.part, 0)))
    return random_tasks(rng.spawn(shard.count), shard.params)


def test_play__keeps_just_the_tasks_that_are_lost() -> None:
    lost = play(SHARD)
    assert lost.part == 3
    wanted = [
        (phi0, target)
        for phi0, target in zip(*_tasks(SHARD), strict=True)
        if _is_lost(SnakeState.initial(phi0, target, PAPER), SHARD.network)
    ]
    assert 5 <= len(wanted) <= 35  # it does lose some, and others not
    np.testing.assert_array_equal(lost.phi0, [phi0 for phi0, _ in wanted])
    np.testing.assert_array_equal(lost.target, [target for _, target in wanted])


def test_play__shards_have_tasks_of_their_own() -> None:
    assert not np.isin(play(SHARD).phi0, play(dataclasses.replace(SHARD, part=4)).phi0).any()
    assert not np.isin(play(SHARD).phi0, play(dataclasses.replace(SHARD, seed=2)).phi0).any()


def test_around__keeps_the_tasks_and_adds_close_ones_that_can_begin() -> None:
    lost: Lost = play(dataclasses.replace(SHARD, count=200))
    rng = np.random.default_rng(0)
    phi0, target = around(lost.phi0, lost.target, 3, 0.02, rng, PAPER)
    count = len(lost.phi0)
    assert 2 * count < len(phi0) == len(target) <= 4 * count
    np.testing.assert_array_equal(phi0[:count], lost.phi0)
    np.testing.assert_array_equal(target[:count], lost.target)
    for near, given in ((phi0[count:], lost.phi0), (target[count:], lost.target)):
        assert np.abs(near).max() <= PAPER.phi_limit
        assert least_distances(near, PAPER).min() >= PAPER.d_collision
        changes = np.abs(near[:, None] - given[None]).max(axis=2).min(axis=1)
        assert 0.0 < changes.min() <= changes.max() < 0.12
        inside = np.abs(near) < PAPER.phi_limit
        closest = given[np.abs(near[:, None] - given[None]).max(axis=2).argmin(axis=1)]
        assert (near - closest)[inside].std() == pytest.approx(0.02, rel=0.1)


def test_around__without_copies_changes_nothing() -> None:
    phi0 = np.zeros((2, 8))
    same = around(phi0, phi0 + 0.1, 0, 0.02, np.random.default_rng(0), PAPER)
    np.testing.assert_array_equal(same, (phi0, phi0 + 0.1))
