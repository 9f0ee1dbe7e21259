"""The critic in a policy's file: the one that is given, PPO's own, or DQN's action values."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from harness.robot import Robot
from snake_env import SnakeParams, load_policy
from snake_env.networks.model_file import Model, read_model, write_model
from snake_env.networks.symmetry import mirror
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.policies.one_step import CriticPolicy
from snake_env.policies.value import ActionValue, NetworkValue, ValueFunction
from snake_env.sim.observation import observe
from snake_env.state import StateBatch
from tests.support.commands import Command
from tests.support.models import model_of, same_network
from tests.support.plus_critic import plus_critic
from tests.support.robots import random_state
from train.__main__ import main
from train.checkpoint import load_checkpoint
from train.run import Run, RunFolder

OWN = SnakeParams(n_joints=6, l=0.1)  # a robot of one's own: nothing ships for it
ROBOT = ("--set", "n_joints=6", "--set", "l=0.1")
LEARN = (
    "--timesteps 512 --segment 512 --num-envs 16 --batch-size 32 --hidden 12 "
    "--validation-tasks 2 --seed 3"
)
WORDS = {
    "ppo": f"ppo --n-steps 16 --critic-hidden 10 {LEARN}",
    "dqn": f"dqn --learning-starts 64 --buffer-size 800 --gradient-steps 2 {LEARN}",
    "imitate": "imitate --rounds 1 --decisions 1024 --hidden 12 --last-epochs 1 --batch-size 64 "
    "--validation-tasks 2 --workers 1 --value {value}",
}


def _critic(seed: int, params: SnakeParams = OWN) -> Model:
    return Model("value", params, model_of(seed, params.n_joints, "value").network)


def _words(command: str, folder: Path, *more: object) -> list[str]:
    value = folder / "value.safetensors"
    write_model(value, _critic(8))
    words = WORDS[command].format(value=value).split()
    return [*words, *ROBOT, "--out", str(folder / "run"), *map(str, more)]


def _trained(command: str, folder: Path, *more: object) -> Path:
    assert main(_words(command, folder, *more)) == 0
    return folder / "run"


def _check(file: Path, value: ValueFunction) -> None:
    """Whether +critic decides by a value function."""
    policy, model = load_policy(f"{file}+critic:k=3", OWN), read_model(file)
    assert isinstance(policy, CriticPolicy)
    for seed in range(30):
        state = random_state(seed, OWN)
        ranked = NetworkPolicy(OWN, model).ranking(state, unless=3)
        told = plus_critic(state, ranked, value, OWN, 3)
        policy.reset()
        before = policy.rollouts
        assert policy.select_mode(state) == told.mode
        assert policy.rollouts - before == told.simulated


def _same(one: Model | None, other: Model) -> bool:
    if one is None or (one.kind, one.params) != (other.kind, other.params):
        return False
    return same_network(one.network, other.network)


@pytest.mark.parametrize("command", ["ppo", "dqn"])
def test_critic__that_is_given_becomes_part_of_the_model(command: str, tmp_path: Path) -> None:
    file = tmp_path / "critic-s3.safetensors"
    write_model(file, _critic(4))
    given = read_model(file)
    run = _trained(command, tmp_path, "--critic", tmp_path / "critic-s{seed}.safetensors")
    for which in ("best", "last"):
        assert _same(read_model(run / f"{which}.safetensors").critic, given)
    _check(run / "last.safetensors", NetworkValue(given, OWN))


@pytest.mark.parametrize(
    ("command", "option"), [("ppo", "--critic"), ("dqn", "--critic"), ("ppo", "--init-critic")]
)
def test_critic__of_no_use_is_refused(
    command: str, option: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "critic.safetensors"
    cases = {
        "model.kind = 'policy': expected value": model_of(0, 6),
        "n_joints = 6: expected 5": _critic(0, SnakeParams(n_joints=5)),
    }
    for told, model in cases.items():
        write_model(file, model)
        words = _words(command, tmp_path, option, file)
        assert Command(main).refusal(capfd, *words).startswith(told)
    words = _words(command, tmp_path, option, tmp_path / "none.safetensors")
    assert "No such file" in Command(main).refusal(capfd, *words)
    assert not (tmp_path / "run").exists()


def test_imitate__has_the_value_network_for_its_critic(tmp_path: Path) -> None:
    run = _trained("imitate", tmp_path)
    assert _same(
        read_model(run / "last.safetensors").critic, read_model(tmp_path / "value.safetensors")
    )


def test_dqn__on_a_robot_of_ones_own_ranks_by_its_action_values(tmp_path: Path) -> None:
    run = _trained("dqn", tmp_path)
    model = read_model(run / "last.safetensors")
    assert model.critic is None
    assert model.params == OWN
    _check(run / "last.safetensors", ActionValue(model, OWN))


def _checkpoint(run: Path) -> dict[str, Any]:
    """What a run has saved."""
    config = json.loads((run / "run.json").read_text())["config"]
    digest = RunFolder(Run(out=run), "ppo", Robot(), config).digest
    return load_checkpoint(run / "checkpoint.pt", digest, "cpu")


def test_ppo__has_its_own_critic(tmp_path: Path) -> None:
    """It is asked about the canonical image, in reward, by the weights in the checkpoint."""
    run = _trained("ppo", tmp_path, "--reward", "time=-0.2", "--reward", "success=3")
    critic = read_model(run / "last.safetensors").critic
    assert critic is not None
    assert (critic.kind, critic.params) == ("value", OWN)
    policy = _checkpoint(run)["policy"]
    order, sign = mirror(6)
    states = StateBatch.stack([random_state(seed, OWN) for seed in range(20)])
    seen, rewards = observe(states, OWN), []
    for image in (seen, seen[:, order] * sign):
        hidden = torch.from_numpy(image)
        for layer in ("mlp_extractor.value_net.0", "value_net"):
            hidden = hidden @ policy[f"{layer}.weight"].T + policy[f"{layer}.bias"]
            if layer != "value_net":
                hidden = hidden.relu()
        rewards.append(hidden.numpy()[:, 0])
    wanted = np.where(states.target[:, -1] >= 0.0, *rewards)
    assert np.abs(rewards[0] - rewards[1]).max() > 1e-3
    value = NetworkValue(critic, OWN)
    np.testing.assert_allclose(3.0 - 0.2 * value(states), wanted, rtol=1e-4, atol=1e-5)
    _check(run / "last.safetensors", value)
