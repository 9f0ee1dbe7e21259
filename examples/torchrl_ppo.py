"""TorchRL: PPO with a masked distribution on ``ActionMaskObservation(env, "torchrl")``.

The wrapper's observations become the tensordict's ``observation`` and ``action_mask`` (of bool), which
``ActionMask`` and ``MaskedCategorical`` expect under these names:

    pip install snake-mode-env torchrl
    python examples/torchrl_ppo.py --steps 20000
"""

import argparse
import sys

import gymnasium
import torch
from tensordict.nn import TensorDictModule
from torchrl.collectors import Collector
from torchrl.envs import ActionMask, GymWrapper, RewardSum, SerialEnv, TransformedEnv
from torchrl.modules import MLP, MaskedCategorical, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from snake_env.envs import ActionMaskObservation

# The first simulation of the paper: a single task, so that learning shows within a minute.
TASK = {"task_suite": "sim-1"}
FRAMES = 1024  # decisions between two updates


def make() -> TransformedEnv:
    """One robot."""
    env = gymnasium.make("snake_env:SnakeModeSelection-v0", **TASK)
    env = GymWrapper(ActionMaskObservation(env, "torchrl"), categorical_action_encoding=True)
    return TransformedEnv(env, ActionMask())


def main() -> None:
    """Learns, and fails unless the return rose."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000, help="decisions to learn from")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)

    env = TransformedEnv(SerialEnv(8, make), RewardSum())
    env.set_seed(args.seed)
    size, n_modes = env.observation_spec["observation"].shape[-1], env.action_spec.space.n
    layers = {"in_features": size, "num_cells": [64, 64], "activation_class": torch.nn.Tanh}
    actor = ProbabilisticActor(
        TensorDictModule(MLP(out_features=n_modes, **layers), ["observation"], ["logits"]),
        in_keys={"logits": "logits", "mask": "action_mask"},
        spec=env.action_spec,
        distribution_class=MaskedCategorical,
        return_log_prob=True,
    )
    critic = ValueOperator(MLP(out_features=1, **layers))
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic, average_gae=True)
    loss = ClipPPOLoss(actor, critic, entropy_coeff=0.01)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-3)
    steps = max(1, args.steps // FRAMES) * FRAMES
    collector = Collector(
        env,
        actor,
        frames_per_batch=FRAMES,
        total_frames=steps,
        auto_register_policy_transforms=False,  # the actor has no memory to reset
    )

    returns: list[float] = []  # of whole episodes
    for data in collector:
        ended = data["next", "done"]
        returns += data["next", "episode_reward"][ended].tolist()
        for _ in range(6):
            advantage(data)
            for rows in torch.randperm(FRAMES).split(256):
                values = loss(data.reshape(-1)[rows])
                total = values["loss_objective"] + values["loss_critic"] + values["loss_entropy"]
                optimizer.zero_grad()
                total.backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimizer.step()
    collector.shutdown()

    before, after = sum(returns[:100]) / 100, sum(returns[-100:]) / 100
    print(f"masked PPO, {steps} steps: mean return {before:.2f} -> {after:.2f}")
    if len(returns) < 200 or after < before + 0.2:
        sys.exit("the return did not rise")


if __name__ == "__main__":
    main()
