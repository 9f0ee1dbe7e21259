"""The no-repeat rule: in the env as in the policies that load_policy gives."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from snake_env import InvalidInputError, SnakeParams
from snake_env.envs import SnakeModeSelectionEnv, SnakeModeSelectionVectorEnv
from snake_env.envs.no_repeat import NoRepeat
from snake_env.networks.model_file import Model
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.sb3 import SnakeVecEnv
from snake_env.sim.masks import action_masks, instant_mask
from tests.support import first
from tests.support.models import model_of, unsure

PARAMS = SnakeParams()


def _reckless(**options: Any) -> SnakeModeSelectionEnv:
    """An env in which infeasible choices leave the robot where it is."""
    return SnakeModeSelectionEnv(on_infeasible="reject", horizon=40, **options)


@pytest.mark.parametrize("network", ["random", "nearly good"])
def test_masks__make_a_greedy_network_play_as_its_policy_does(network: str) -> None:
    model = model_of(4) if network == "random" else Model("policy", PARAMS, unsure())
    policy, env = NetworkPolicy(PARAMS, model), _reckless(no_repeat=True)
    closed = 0
    for seed in range(20):
        observation, info = env.reset(seed=seed)
        policy.reset()
        over = False
        while not over:
            ranks = policy._network(observation[None])[0]
            mask = info["action_mask"].astype(bool)
            closed += int(mask.sum() < _plain_mask(env).sum())
            mode = int(np.where(mask, ranks, -np.inf).argmax())
            assert mode == policy.select_mode(env.state)
            observation, _, terminated, truncated, info = env.step(mode)
            over = terminated or truncated
    assert closed > 20


def _plain_mask(env: SnakeModeSelectionEnv) -> np.ndarray:
    return instant_mask(env.state, env.params)


def test_masks__close_what_did_nothing_until_the_robot_moves() -> None:
    env = _reckless(no_repeat=True)

    def blocked_after_reset(seed: int) -> np.ndarray:
        env.reset(seed=seed)
        return np.flatnonzero(~_feasible(env) & _plain_mask(env))

    blocked = first(b for b in map(blocked_after_reset, range(40)) if len(b) >= 4)
    expected = _plain_mask(env)
    for mode in blocked[:4]:
        assert np.array_equal(env.action_masks(), expected)
        env.step(mode)
        expected[mode] = False
    env.step(np.flatnonzero(_feasible(env))[0])
    assert np.array_equal(env.action_masks(), _plain_mask(env))


def _feasible(env: SnakeModeSelectionEnv) -> np.ndarray:
    return action_masks(env.core.states, env.params, "lookahead")[0]


def test_rule__leaves_one_choice_at_least() -> None:
    env = SnakeModeSelectionEnv()
    env.reset(seed=0)
    rule, only = NoRepeat(1, 99), np.array([0])
    rule.restart(only, env.core.states)
    mask = np.zeros((1, 99), dtype=np.bool_)
    mask[0, [4, 7]] = True
    for tried, left in ((4, [7]), (7, [4, 7])):
        rule.record(only, np.array([tried]), env.core.states)
        assert np.flatnonzero(rule.without_tried(only, mask)).tolist() == left


def test_vector_env__closes_what_single_ones_do() -> None:
    count = 5
    envs = SnakeModeSelectionVectorEnv(
        count, no_repeat=True, on_infeasible="reject", horizon=9, autoreset_mode="SameStep"
    )
    singles = [
        SnakeModeSelectionEnv(no_repeat=True, on_infeasible="reject", horizon=9)
        for _ in range(count)
    ]
    _, info = envs.reset(seed=11)
    masks = [env.reset(seed=11 + k)[1]["action_mask"] for k, env in enumerate(singles)]
    rng = np.random.default_rng(0)
    for _ in range(30):
        assert np.array_equal(info["action_mask"], masks)
        actions = np.array([rng.choice(np.flatnonzero(mask)) for mask in masks])
        *_, info = envs.step(actions)
        for k, env in enumerate(singles):
            *_, terminated, truncated, own = env.step(actions[k])
            masks[k] = (
                env.reset()[1]["action_mask"] if terminated or truncated else own["action_mask"]
            )


def test_state_of_an_env__keeps_what_was_tried() -> None:
    env = _reckless(no_repeat=True)
    env.reset(seed=3)
    mode = np.flatnonzero(~_feasible(env) & _plain_mask(env))[0]
    env.step(mode)
    saved, before = env.get_state(), env.action_masks()
    env.reset(seed=4)
    env.set_state(saved)
    assert np.array_equal(env.action_masks(), before)
    assert not before[mode]


def test_option__is_there_however_the_env_is_made() -> None:
    for env in (
        gymnasium.make("snake_env:SnakeModeSelection-v0", no_repeat=True).unwrapped,
        gymnasium.make_vec("snake_env:SnakeModeSelection-v0", num_envs=2, no_repeat=True),
        SnakeVecEnv(2, mask_in_observation=True, no_repeat=True).envs,
    ):
        assert env.core.no_repeat is not None
    assert SnakeModeSelectionEnv().core.no_repeat is None
    with pytest.raises(InvalidInputError, match=r"^no_repeat = 1: expected True or False$"):
        SnakeModeSelectionEnv(no_repeat=1)
