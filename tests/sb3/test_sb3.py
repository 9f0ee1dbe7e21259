"""The adapter for Stable-Baselines3."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize, VecVideoRecorder

from snake_env import InvalidInputError
from snake_env.envs import SnakeModeSelectionEnv
from snake_env.sb3 import MaskedActorCriticPolicy, MaskedDQN, MaskedDQNPolicy, SnakeVecEnv
from snake_env.sb3.masked import checked_mask


def masked(masks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.array([rng.choice(np.flatnonzero(mask)) for mask in masks])


def test_episodes__are_those_of_single_envs() -> None:
    count = 3
    venv = SnakeVecEnv(count, horizon=6)
    venv.seed(7)
    observation = venv.reset()
    singles = [SnakeModeSelectionEnv(horizon=6) for _ in range(count)]
    starts = [env.reset(seed=7 + k) for k, env in enumerate(singles)]
    returns, lengths, ended = np.zeros(count), np.zeros(count), 0
    assert np.array_equal(observation, [start[0] for start in starts])
    rng = np.random.default_rng(0)
    for _ in range(25):
        actions = masked(venv.action_masks(), rng)
        observation, reward, done, infos = venv.step(actions)
        for k, env in enumerate(singles):
            single, r, terminated, truncated, info = env.step(actions[k])
            returns[k] += r
            lengths[k] += 1
            assert reward[k] == np.float32(r)
            assert done[k] == (terminated or truncated)
            if not done[k]:
                assert infos[k] == {}
                assert np.array_equal(observation[k], single)
                continue
            assert np.array_equal(infos[k]["terminal_observation"], single)
            assert infos[k]["TimeLimit.truncated"] is False  # a failure's reward is final
            assert infos[k]["is_success"] == info["is_success"]
            assert infos[k]["episode_summary"] == info["episode_summary"]
            assert infos[k]["episode"]["r"] == pytest.approx(returns[k])
            assert infos[k]["episode"]["l"] == lengths[k]
            single, _ = env.reset()
            assert np.array_equal(observation[k], single)
            returns[k] = lengths[k] = 0
            ended += 1
    assert ended > 5


def test_masks__are_found_the_way_sb3_contrib_looks_for_them() -> None:
    venv = SnakeVecEnv(4)
    venv.reset()
    assert np.array_equal(np.stack(venv.env_method("action_masks")), venv.action_masks())
    assert len(venv.env_method("action_masks", indices=[1, 2])) == 2
    assert venv.env_method("render") == [None] * venv.num_envs
    with pytest.raises(AttributeError, match="the robots have no attribute 'reset'"):
        venv.env_method("reset")
    with pytest.raises(TypeError, match="takes no arguments"):
        venv.env_method("render", "human")
    assert venv.env_is_wrapped(Monitor) == [True] * 4
    assert venv.has_attr("params")
    assert not venv.has_attr("parms")


def test_mask_in_observation__is_the_mask() -> None:
    venv = SnakeVecEnv(4, mask_in_observation=True)
    observation = venv.reset()
    assert np.array_equal(observation["action_mask"], venv.action_masks())
    assert venv.observation_space["action_mask"].contains(observation["action_mask"][0])


@pytest.mark.parametrize("dictionary", [False, True])
def test_ppo__trains(dictionary: bool) -> None:
    venv = SnakeVecEnv(8, mask_in_observation=dictionary, task_suite="random:4:1")
    policy = "MultiInputPolicy" if dictionary else "MlpPolicy"
    model = PPO(policy, venv, n_steps=16, batch_size=64, n_epochs=1, seed=0, device="cpu")
    before = [p.detach().clone() for p in model.policy.parameters()]
    model.learn(256)
    after = list(model.policy.parameters())
    assert model.num_timesteps == 256
    assert any(not np.allclose(a.detach(), b) for a, b in zip(after, before, strict=True))
    assert len(model.ep_info_buffer) > 0


def test_set_attr__for_some_robots_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="share one env"):
        SnakeVecEnv(2).set_attr("x", 1, indices=[0])


@pytest.mark.parametrize("algorithm", [PPO, MaskedDQN])
def test_normalised_mask__is_an_error_that_names_the_remedy(algorithm: Any) -> None:
    policy = MaskedActorCriticPolicy if algorithm is PPO else MaskedDQNPolicy
    small = {"n_steps": 8} if algorithm is PPO else {"learning_starts": 4}
    env = VecNormalize(SnakeVecEnv(4, mask_in_observation=True))
    with pytest.raises(
        InvalidInputError, match=r'^action_mask = .*norm_obs_keys=\["observation"\]'
    ):
        algorithm(policy, env, **small).learn(64)
    good = VecNormalize(
        SnakeVecEnv(4, mask_in_observation=True), norm_obs_keys=["observation"], norm_reward=False
    )
    algorithm(policy, good, **small).learn(32)


@pytest.mark.parametrize("wrong", [0.3, 2.0, -1.0, float("nan")])
def test_mask__of_anything_but_0_and_1_is_refused(wrong: float) -> None:
    mask = torch.ones(3, 99)
    assert checked_mask(mask) is mask
    mask[1, 5] = wrong
    with pytest.raises(InvalidInputError, match=r"^action_mask = "):
        checked_mask(mask)


def _stacked(frames: int) -> VecFrameStack:
    return VecFrameStack(SnakeVecEnv(2, mask_in_observation=True), frames)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: _stacked(2), "not stacked ones: remove VecFr"),
        (lambda: _stacked(4), "not stacked ones: remove VecFr"),
        (lambda: SnakeVecEnv(2), "mask_in_observation=True"),
    ],
)
@pytest.mark.parametrize("algorithm", [PPO, MaskedDQN])
def test_observations_that_the_policies_do_not_know__are_named(
    algorithm: Any, make: Any, message: str
) -> None:
    policy = MaskedActorCriticPolicy if algorithm is PPO else MaskedDQNPolicy
    with pytest.raises(InvalidInputError, match=f"^observation_space = .*{message}"):
        algorithm(policy, make())


def test_video__shows_every_robot(tmp_path: Path) -> None:
    env = SnakeVecEnv(3, render_mode="rgb_array")
    with pytest.raises(ResetNeeded, match="reset"):
        env.render()
    recorder = VecVideoRecorder(env, str(tmp_path), lambda step: step == 0, video_length=4)
    recorder.reset()
    for _ in range(5):
        recorder.step(env.action_masks().argmax(axis=1))
    recorder.close()
    assert [path.suffix for path in tmp_path.iterdir()] == [".mp4"]
    images = env.get_images()
    assert [image.shape for image in images] == [(480, 640, 3)] * 3
    assert len({image.tobytes() for image in images}) == 3
    assert SnakeVecEnv(2).get_images() == [None, None]
