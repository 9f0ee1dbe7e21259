"""The env: Gymnasium's contract, its docstring, episodes, kwargs, saving and restoring."""

import copy
import inspect
import json
import pickle
import re
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_checker import data_equivalence as same
from hypothesis import given, settings
from hypothesis import strategies as st

from snake_env import (
    InvalidInputError,
    InvalidModeError,
    UnknownNameError,
    action_mask,
    advance,
    load_policy,
    predict,
    trajectory,
)
from snake_env.envs import SnakeModeSelectionEnv
from snake_env.envs.reward import RewardWeights
from snake_env.modes import mode_table
from snake_env.sim.observation import observation_rows, observation_size
from tests.support import oracle
from tests.support.robots import oracle_constants, same_state

IDS = sorted(name for name in gymnasium.registry if name.startswith("SnakeModeSelection"))
ID = "snake_env:SnakeModeSelection-v0"
DOC = inspect.getdoc(SnakeModeSelectionEnv) or ""


def masked_action(rng: np.random.Generator, info: dict) -> int:
    return int(rng.choice(np.flatnonzero(info["action_mask"])))


@pytest.mark.parametrize("name", IDS)
def test_check_env__passes_without_a_warning(name: str) -> None:
    env = gymnasium.make(f"snake_env:{name}").unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize("name", IDS)
def test_sb3_check_env__passes_without_a_warning(name: str) -> None:
    from stable_baselines3.common.env_checker import check_env as check

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(gymnasium.make(f"snake_env:{name}").unwrapped)


@pytest.mark.parametrize("name", IDS)
def test_make__spec_is_json_and_pickles(name: str) -> None:
    env = gymnasium.make(f"snake_env:{name}", slip=[0.001, 0.002], a_c=67.0)
    spec = gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json())
    assert json.loads(env.spec.to_json())["kwargs"]["a_c"] == 67.0
    assert gymnasium.make(spec).unwrapped.params == env.unwrapped.params
    assert pickle.loads(pickle.dumps(env.unwrapped)).params.a_c == 67.0


@pytest.mark.parametrize("kwargs", [{}, {"slip": (0.002, 0.01)}, {"on_infeasible": "reject"}])
def test_two_envs__do_the_same(kwargs: dict) -> None:
    envs = [gymnasium.make(ID, **kwargs) for _ in range(2)]
    rng = np.random.default_rng(0)
    for seed in range(4):
        results = [env.reset(seed=seed) for env in envs]
        for _ in range(12):
            assert same(*results, exact=True)
            results = [
                env.step(action) for action in [masked_action(rng, results[0][-1])] for env in envs
            ]
            if results[0][2] or results[0][3]:
                break


def test_docstring__describes_every_row_of_the_observation() -> None:
    rows = re.findall(r"\| (\d+)\.\.(\d+) \| ``(\w+)`` \|", DOC)
    start = 0
    for (first, last, name), (expected, size) in zip(rows, observation_rows(8), strict=True):
        assert (int(first), int(last), name) == (start, start + size - 1, expected)
        start += size
    assert start == observation_size(8) == 99
    for n in (5, 8, 12):
        assert observation_size(n) == 10 * n + 19


def test_docstring__names_every_argument_with_its_default() -> None:
    table = DOC[DOC.index("## Arguments") : DOC.index("## Version History")]
    documented = dict(re.findall(r"\| ``([\w*]+)`` \|[^|]*\|\s*(?:``(.*?)``)? ?\|", table))
    signature = inspect.signature(SnakeModeSelectionEnv.__init__).parameters
    expected = {
        name: json.dumps(p.default) if isinstance(p.default, str) else str(p.default)
        for name, p in signature.items()
        if name not in ("self", "params")
    }
    assert documented == {**expected, "**params": ""}


def test_docstring__names_every_reward_weight() -> None:
    table = DOC[DOC.index("## Rewards") : DOC.index("## Starting State")]
    documented = {k: float(v) for k, v in re.findall(r"\| ``(\w+)`` \| (-?[\d.]+) \|", table)}
    assert {**documented, "gamma": 0.99} == vars(RewardWeights())


def test_docstring__names_every_info_key() -> None:
    env = SnakeModeSelectionEnv()
    _, info = env.reset(seed=0)
    table = DOC[DOC.index("## Information") : DOC.index("## Arguments")]
    documented = set(re.findall(r"^\| ``(\w+)`` \|", table, re.MULTILINE))
    assert documented == {*info, "episode_summary"}


def test_step__is_advance() -> None:
    env = SnakeModeSelectionEnv()
    env.reset(seed=3)
    before = env.state
    mode = load_policy("analytic").select_mode(before)
    *_, info = env.step(mode)
    after, prediction = advance(before, mode, env.params)
    assert np.array_equal(env.state.phi, after.phi)
    assert (env.state.phase, info["elapsed_s"]) == (after.phase, after.elapsed)
    assert info["d_min"] == prediction.d_min[0]
    assert info["lifted"].tolist() == [
        int(k == before.phase or up)
        for k, up in enumerate(mode_table(8).lifted[mode].tolist(), start=1)
    ]


def test_episode__of_the_optimiser_ends_in_success() -> None:
    env = SnakeModeSelectionEnv(task_suite="sim-1")
    policy = load_policy("analytic")
    _, info = env.reset(seed=0, options={"task": 0})
    total = 0.0
    for _ in range(20):
        _, reward, terminated, truncated, info = env.step(policy.select_mode(env.state))
        assert reward == pytest.approx(sum(info["reward_terms"].values()), abs=1e-15)
        total += reward
        if terminated or truncated:
            break
    assert terminated
    assert not truncated
    assert info["is_success"]
    summary = info["episode_summary"]
    assert (summary["outcome"], summary["intervals"], summary["time_s"]) == ("success", 12, 36.0)
    assert total == pytest.approx(1.0 - 12 * 0.1, abs=1e-12)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)


def test_invalid_mode__is_a_violation_and_executes_nothing() -> None:
    env = SnakeModeSelectionEnv()
    env.reset(seed=0)
    env.set_state(env.state.replace(phase=4))
    before = env.state
    _, reward, terminated, _, info = env.step(mode_table(8).index([3]))
    assert terminated
    assert info["violation"] == "invalid_mode"
    assert np.array_equal(env.state.phi, before.phi)
    assert info["elapsed_s"] == before.elapsed
    assert reward == pytest.approx(-30.0)  # a violation in the first interval


def infeasible_choice(env: SnakeModeSelectionEnv) -> int:
    """Resets the env to a state with an infeasible mode in the mask; that mode."""
    for seed in range(50):
        _, info = env.reset(seed=seed)
        masked = np.flatnonzero(info["action_mask"])
        broken = masked[~predict(env.state, masked, env.params).feasible]
        if len(broken):
            return int(broken[0])
    raise AssertionError("none found")


def test_reject__holds_still_and_time_passes() -> None:
    env = SnakeModeSelectionEnv(on_infeasible="reject")
    mode = infeasible_choice(env)
    before = env.state
    _, reward, terminated, truncated, info = env.step(mode)
    assert not terminated
    assert not truncated
    assert info["violation"] in ("stability", "joint_limit")
    assert np.array_equal(env.state.phi, before.phi)
    assert env.state.elapsed == 3.0
    assert env.state.phase_time == 0.0  # the cam curve waits
    assert not info["lifted"].any()
    assert reward == pytest.approx(-0.1)


def test_terminate__stops_where_the_violation_occurred() -> None:
    env = SnakeModeSelectionEnv()
    mode = infeasible_choice(env)
    _, _, terminated, _, info = env.step(mode)
    assert terminated
    assert info["episode_summary"]["outcome"] == info["violation"] != ""
    assert 0 < info["elapsed_s"] <= 3.0 + 1e-9


def test_horizon__truncates() -> None:
    env = SnakeModeSelectionEnv(on_infeasible="reject", horizon=3)
    env.reset(seed=0)
    env.set_state(env.state.replace(phase=5))
    ends = [env.step(1)[2:4] for _ in range(3)]  # wheel 2 may not be lifted: rejected
    assert ends == [(False, False), (False, False), (False, True)]


def test_lingering__is_never_paid() -> None:
    env = SnakeModeSelectionEnv(on_infeasible="reject")
    env.reset(seed=1)
    for action in range(30):
        _, _, terminated, _, info = env.step(action)
        terms = info["reward_terms"]
        assert terms["time"] < 0
        if not info["is_success"]:
            assert sum(terms.values()) < 0
        if terminated:
            break


def test_shaping__telescopes() -> None:
    env = SnakeModeSelectionEnv(
        task_suite="sim-1", reward_weights={"shaping": 2.0, "gamma": 1.0, "time": 0.0}
    )
    policy = load_policy("analytic")
    env.reset(seed=0)
    state = env.state
    potential = -(7 + abs(state.target[0] - state.phi[0]) / np.pi)
    shaped, terminated = 0.0, False
    while not terminated:
        _, _, terminated, _, info = env.step(policy.select_mode(env.state))
        shaped += info["reward_terms"]["shaping"]
    assert shaped == pytest.approx(-2.0 * potential)


@pytest.mark.parametrize("ending", ["stability", "horizon"])
def test_shaping__pays_every_failure_alike(ending: str) -> None:
    """Phi is 0 where an episode ends, so that shaping changes no optimal policy."""
    weights = {"shaping": 1.0, "gamma": 1.0, "time": 0.0}
    env = SnakeModeSelectionEnv(task_suite="sim-1", reward_weights=weights, horizon=2)
    env.reset(seed=0)
    state = env.state
    potential = -(7 + abs(state.target[0] - state.phi[0]) / np.pi)
    feasible = action_mask(state, env.params, "lookahead").astype(bool)
    shaped, over, info = 0.0, False, {}
    while not over:
        allowed = feasible if ending == "horizon" else ~feasible
        _, _, terminated, truncated, info = env.step(int(np.flatnonzero(allowed)[0]))
        shaped += info["reward_terms"]["shaping"]
        over = terminated or truncated
    assert info["episode_summary"]["outcome"] in (ending, "deadlock")
    assert shaped == pytest.approx(-potential)


def test_slip__moves_the_head_and_wheels_still_roll() -> None:
    env = SnakeModeSelectionEnv(slip=(0.005, 0.02))
    _, info = env.reset(seed=4)
    rng = np.random.default_rng(0)
    constants = oracle_constants(env.params)
    for _ in range(3):
        before, mode = env.state, masked_action(rng, info)
        motion = trajectory(before, mode, env.params)
        a, b = oracle.matrices(motion.w[7], motion.phi[7], constants)
        rate = (motion.w[8] - motion.w[7]) / env.params.dt
        lifted = mode_table(8).lifted[mode].copy()
        lifted[before.phase - 1] = True
        assert np.abs((a @ rate - b @ motion.u[7])[~lifted]).max() < 1e-10
        *_, terminated, _, info = env.step(mode)
        assert np.abs(env.state.w - motion.w[-1]).max() > 1e-5
        if terminated:
            break


def _future(env: SnakeModeSelectionEnv) -> list[tuple]:
    """Some steps, each with a mode that the mask allows, up to the end of the episode."""
    rng, steps = np.random.default_rng(0), []
    for _ in range(5):
        steps.append(env.step(int(rng.choice(np.flatnonzero(env.action_masks())))))
        if steps[-1][2] or steps[-1][3]:
            break
    return steps


def test_state__saved_and_restored_gives_the_same_future() -> None:
    env = SnakeModeSelectionEnv(slip=(0.002, 0.01))
    env.reset(seed=5)
    env.step(8)
    saved = env.get_state()
    futures = [_future(twin) for twin in (env, copy.deepcopy(env), pickle.loads(pickle.dumps(env)))]
    env.set_state(saved)
    futures.append(_future(env))
    assert len(futures[0]) >= 3
    for future in futures[1:]:
        assert len(future) == len(futures[0])
        assert all(same(*steps, exact=True) for steps in zip(futures[0], future, strict=True))


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"horizon": 5}, "horizon"),
        ({"preset": "narrow"}, "head_contact"),
        ({"preset": "six"}, "n_joints"),
        ({"no_repeat": True}, "no_repeat"),
    ],
)
def test_state__of_an_env_with_other_constants_is_refused(
    options: dict[str, Any], named: str
) -> None:
    other, env = SnakeModeSelectionEnv(**options), SnakeModeSelectionEnv()
    other.reset(seed=0)
    env.reset(seed=1)
    before = env.state
    with pytest.raises(InvalidInputError, match=rf"an env with the same .*{named}"):
        env.set_state(other.get_state())
    assert same_state(env.state, before)


def test_state__with_intervals_behind_it_has_only_the_others_left() -> None:
    env = SnakeModeSelectionEnv()
    env.reset(seed=0)
    env.set_state(env.state.replace(elapsed=297.0))
    assert env.step(0)[4]["episode_summary"]["intervals"] == 100


def test_observations_and_infos__are_fresh() -> None:
    env = SnakeModeSelectionEnv()
    first, info = env.reset(seed=0)
    kept, kept_mask = first.copy(), info["action_mask"].copy()
    env.step(8)
    env.reset(seed=1)
    assert np.array_equal(first, kept)
    assert np.array_equal(info["action_mask"], kept_mask)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    masked=st.booleans(),
    kwargs=st.fixed_dictionaries(
        {
            "preset": st.sampled_from(["paper", "narrow", "hardware"]),
            "on_infeasible": st.sampled_from(["terminate", "reject"]),
            "mask_level": st.sampled_from(["structural", "instant", "lookahead"]),
            "n_joints": st.sampled_from([5, 6, 8, 9]),
            "slip": st.sampled_from([(0.0, 0.0), (0.01, 0.05)]),
        }
    ),
)
def test_any_episode__stays_finite_and_within_the_space(
    seed: int, masked: bool, kwargs: dict
) -> None:
    env = SnakeModeSelectionEnv(**kwargs)
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    for _ in range(12):
        assert env.observation_space.contains(observation)
        assert info["action_mask"].any()
        action = masked_action(rng, info) if masked else int(rng.integers(env.action_space.n))
        observation, reward, terminated, truncated, info = env.step(action)
        assert np.isfinite(reward)
        assert np.isfinite([info["d_min"], info["max_abs_phi"], info["elapsed_s"]]).all()
        assert all(np.isfinite(list(info["reward_terms"].values())))
        if masked:
            assert info["violation"] != "invalid_mode"
        if masked and kwargs["mask_level"] == "lookahead" and info["violation"]:
            assert info["violation"] in ("collision", "stability", "joint_limit")
        if terminated or truncated:
            break


@pytest.mark.parametrize(
    ("kwargs", "error", "hint"),
    [
        ({"preset": "papr"}, UnknownNameError, "did you mean 'paper'"),
        ({"mask_level": "instnt"}, UnknownNameError, "did you mean 'instant'"),
        ({"on_infeasible": "rejct"}, UnknownNameError, "did you mean 'reject'"),
        ({"reward_weights": {"tme": 1.0}}, UnknownNameError, "did you mean 'time'"),
        ({"reward_weights": {"time": float("nan")}}, InvalidInputError, "time"),
        ({"slip": (0.1,)}, InvalidInputError, "slip"),
        ({"slip": (-0.1, 0.0)}, InvalidInputError, "slip"),
        ({"task_suite": "paper-50"}, UnknownNameError, "did you mean 'paper-500'"),
        ({"render_mode": "rgb"}, UnknownNameError, "rgb_array"),
        ({"n_joint": 6}, UnknownNameError, "did you mean 'n_joints'"),
        ({"n_joints": 4}, InvalidInputError, "n_joints = 4"),
    ],
)
def test_bad_kwarg__is_named(kwargs: dict, error: type[Exception], hint: str) -> None:
    with pytest.raises(error, match=re.escape(hint)):
        SnakeModeSelectionEnv(**kwargs)


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        ({"phi": [0.0] * 8}, "did you mean 'phi0'"),
        ({"phi0": [0.0] * 7}, "phi0.shape"),
        ({"phi0": [9.0] + [0.0] * 7}, "phi0[0] = 9.0"),
        ({"task": 0}, "task_suite"),
    ],
)
def test_bad_reset_option__is_named(options: dict, hint: str) -> None:
    with pytest.raises((InvalidInputError, UnknownNameError), match=re.escape(hint)):
        SnakeModeSelectionEnv().reset(options=options)


@pytest.mark.parametrize("task", [-1, 1, "0", 0.5])
def test_task_outside_the_suite__is_refused(task: object) -> None:
    with pytest.raises(InvalidInputError, match="0 to 0"):
        SnakeModeSelectionEnv(task_suite="sim-1").reset(options={"task": task})


@pytest.mark.parametrize("action", [-1, 99])
def test_action_outside_the_space__raises(action: int) -> None:
    env = SnakeModeSelectionEnv()
    env.reset(seed=0)
    with pytest.raises(InvalidModeError, match=f"action = {action}"):
        env.step(action)


def test_step_before_reset__raises() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded):
        SnakeModeSelectionEnv().step(0)
