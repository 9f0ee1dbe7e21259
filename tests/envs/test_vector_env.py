"""The vector env against Gymnasium's SyncVectorEnv, and its own contract."""

import copy
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from snake_env import InvalidInputError, UnknownNameError, set_num_threads
from snake_env.envs import SnakeModeSelectionVectorEnv

ID = "snake_env:SnakeModeSelection-v0"


def assert_same(ours: Any, theirs: Any, path: str = "") -> None:
    """Equal bit for bit; where SyncVectorEnv has None for a missing text, ours is empty."""
    if isinstance(theirs, dict):
        assert set(ours) == set(theirs), path
        for key in theirs:
            assert_same(ours[key], theirs[key], f"{path}/{key}")
    elif theirs.dtype == object:
        for mine, other in zip(ours, theirs, strict=True):
            if isinstance(other, np.ndarray):
                assert np.array_equal(mine, other), path
            else:
                assert (mine or "") == (other or ""), path
    else:
        assert ours.dtype == theirs.dtype, path
        assert np.array_equal(ours, theirs), path


def actions_for(info: dict[str, Any], rng: np.random.Generator) -> np.ndarray:
    """Mostly allowed modes, now and then any."""
    return np.array(
        [
            rng.choice(np.flatnonzero(mask)) if rng.random() < 0.9 else rng.integers(len(mask))
            for mask in info["action_mask"]
        ]
    )


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize(
    "kwargs",
    [
        {},
        {
            "slip": (0.003, 0.01),
            "on_infeasible": "reject",
            "mask_level": "structural",
            "horizon": 7,
        },
        {"task_suite": "random:7:1", "preset": "narrow", "reward_weights": {"shaping": 1.0}},
    ],
)
def test_transitions__are_those_of_sync_vector_env(mode: AutoresetMode, kwargs: Any) -> None:
    count = 9  # one more than a block of lanes
    ours = gymnasium.make_vec(ID, num_envs=count, autoreset_mode=mode, **kwargs)
    assert isinstance(ours.unwrapped, SnakeModeSelectionVectorEnv)
    theirs = gymnasium.make_vec(
        ID,
        num_envs=count,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": mode},
        **kwargs,
    )
    results = [env.reset(seed=5) for env in (ours, theirs)]
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(40):
        for mine, other in zip(*results, strict=True):
            assert_same(mine, other)
        actions = actions_for(results[1][-1], rng)
        results = [env.step(actions) for env in (ours, theirs)]
        ended += int((results[0][2] | results[0][3]).sum())
    assert ended > 5


@pytest.mark.parametrize("threads", [2, 3])
def test_threads__change_nothing(threads: int) -> None:
    runs = []
    for count in (1, threads):
        set_num_threads(count)
        try:
            env = SnakeModeSelectionVectorEnv(50)
            _, info = env.reset(seed=1)
            rng = np.random.default_rng(0)
            steps = []
            for _ in range(5):
                *step, info = env.step(actions_for(info, rng))
                steps.append(step)
            runs.append(steps)
        finally:
            set_num_threads(1)
    for one, many in zip(*runs, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one, many, strict=True))


def test_reset_mask__resets_only_those() -> None:
    env = SnakeModeSelectionVectorEnv(4, AutoresetMode.DISABLED)
    first, _ = env.reset(seed=0)
    mask = np.array([False, True, False, True])
    second, info = env.reset(options={"reset_mask": mask})
    assert np.array_equal(first[~mask], second[~mask])
    assert not np.array_equal(first[1], second[1])
    assert info["_phase"].tolist() == mask.tolist()


def test_disabled_autoreset__asks_for_a_reset() -> None:
    env = SnakeModeSelectionVectorEnv(2, AutoresetMode.DISABLED, horizon=1)
    _, _info = env.reset(seed=0)
    env.step([0, 0])
    with pytest.raises(InvalidInputError, match="reset"):
        env.step([0, 0])


def test_returned_arrays__are_copies() -> None:
    env = SnakeModeSelectionVectorEnv(3)
    first, info = env.reset(seed=0)
    kept = first.copy()
    env.step(actions_for(info, np.random.default_rng(0)))
    assert np.array_equal(first, kept)
    assert env.observation_space.contains(first)


def test_deep_copy__goes_the_same_way() -> None:
    env = SnakeModeSelectionVectorEnv(5, slip=(0.01, 0.01))
    _, info = env.reset(seed=0)
    twin = copy.deepcopy(env)
    actions = actions_for(info, np.random.default_rng(0))
    ours, theirs = env.step(actions), twin.step(actions)
    assert np.array_equal(ours[0], theirs[0])


@pytest.mark.parametrize("context", ["spawn", "forkserver"])
def test_worker_processes__find_the_id(context: str) -> None:
    workers = {"context": context}
    env = gymnasium.make_vec(ID, num_envs=2, vectorization_mode="async", vector_kwargs=workers)
    try:
        observation, _ = env.reset(seed=3)
    finally:
        env.close()
    expected, _ = SnakeModeSelectionVectorEnv(2).reset(seed=3)
    assert np.array_equal(observation, expected)


@pytest.mark.parametrize(
    ("call", "error", "hint"),
    [
        (lambda: SnakeModeSelectionVectorEnv(0), InvalidInputError, "num_envs = 0"),
        (lambda: SnakeModeSelectionVectorEnv(2, preset="x"), UnknownNameError, "preset"),
        (lambda: SnakeModeSelectionVectorEnv(2, render_mode="human"), InvalidInputError, "render"),
        (lambda: SnakeModeSelectionVectorEnv(2).reset(seed=[1]), InvalidInputError, "2 seeds"),
        (
            lambda: _reset().reset(options={"reset_mask": np.zeros(2, dtype=bool)}),
            InvalidInputError,
            "reset_mask",
        ),
    ],
)
def test_bad_input__is_named(call: Any, error: type[Exception], hint: str) -> None:
    with pytest.raises(error, match=hint):
        call()


def _reset() -> SnakeModeSelectionVectorEnv:
    env = SnakeModeSelectionVectorEnv(2)
    env.reset(seed=0)
    return env


def test_slip_of_each__is_that_of_an_env_of_its_own() -> None:
    slip = [(0.0, 0.0), (0.003, 0.01), (0.0, 0.0), (0.001, 0.0)]
    together = SnakeModeSelectionVectorEnv(
        4, slip=slip, horizon=3, autoreset_mode=AutoresetMode.NEXT_STEP
    )
    alone = [
        SnakeModeSelectionVectorEnv(1, slip=pair, horizon=3, autoreset_mode=AutoresetMode.NEXT_STEP)
        for pair in slip
    ]
    observation, info = together.reset(seed=5)
    rows = [env.reset(seed=5 + k) for k, env in enumerate(alone)]
    for _ in range(10):  # over the ends of some episodes
        assert np.array_equal(observation, np.concatenate([row[0] for row in rows]))
        modes = info["action_mask"].argmax(axis=1)
        observation, *_, info = together.step(modes)
        rows = [env.step(modes[k : k + 1]) for k, env in enumerate(alone)]
