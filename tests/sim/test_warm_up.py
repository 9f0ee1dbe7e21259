"""Compiled programs: loaded before the work, and only those that it needs."""

import logging
from pathlib import Path

import pytest

from snake_env.kernel import compiler
from snake_env.kernel.blocks import block_widths
from snake_env.kernel.distance import get_distance_program
from snake_env.kernel.instant_mask import get_mask_kernel
from snake_env.kernel.interval import get_kernel
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.baselines import AnalyticPolicy
from snake_env.policies.ends import get_ends_program
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.policies.one_step import CriticPolicy, ValuePolicy, best_mode
from snake_env.policies.value import ActionValue, NetworkValue
from snake_env.sim.masks import action_masks
from snake_env.sim.observation import get_observation_kernel
from snake_env.sim.warm_up import warm_up
from snake_env.state import StateBatch
from tests.support.models import model_of
from tests.support.robots import random_state


def test_warm_up__leaves_nothing_to_compile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv(compiler.CACHE_VARIABLE, str(tmp_path))
    programs = (get_kernel, get_mask_kernel, get_observation_kernel, get_distance_program)
    for cached in (*programs, get_ends_program):
        cached.cache_clear()
    model = model_of(n_joints=5)
    params = SnakeParams(n_joints=5)
    with caplog.at_level(logging.WARNING):
        warm_up(params)
        assert caplog.text.count("compiling") == 2 + len(block_widths())
        caplog.clear()
        state = random_state(0, params)
        action_masks(StateBatch.stack([state]), params, "lookahead")
        AnalyticPolicy(params).select_mode(state)
        assert not caplog.records  # (21) needs no observations
        policy = NetworkPolicy(params, model)
        assert caplog.text.count("compiling") == 1
        caplog.clear()
        policy.select_mode(state)
        assert not caplog.records  # nor do policies without a critic need what its ends look like
        value = NetworkValue(model_of(n_joints=5, kind="value"), params)
        critic = CriticPolicy(policy, value, params)
        assert caplog.text.count("compiling") == len(block_widths())
        caplog.clear()
        critic.select_mode(state)
        ValuePolicy(params, value).select_mode(state)
        for count in (1, 2, 4, 8):
            valid = mode_table(5).valid(state.phase)
            best_mode(state, valid[:count], value, params)
    assert not caplog.records


def test_planner_and_action_values__leave_nothing_to_compile_to_the_first_decision(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv(compiler.CACHE_VARIABLE, str(tmp_path))
    params = SnakeParams(n_joints=5)
    batch = StateBatch.stack([random_state(0, params)])
    makes = (
        lambda: NetworkValue(model_of(n_joints=5, kind="value"), params),
        lambda: ActionValue(model_of(n_joints=5), params),
    )
    for make in makes:
        get_observation_kernel.cache_clear()
        warm_up(params)
        with caplog.at_level(logging.WARNING):
            value = make()
            caplog.clear()
            value(batch)
        assert not caplog.records
