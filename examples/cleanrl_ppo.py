"""Masked PPO in one file and in CleanRL's style: PyTorch, ``gymnasium.make_vec``, nothing else.

    pip install snake-mode-env torch
    python examples/cleanrl_ppo.py --steps 60000

The robots restart by themselves. With ``SAME_STEP`` the step that ends an episode returns the first
observation (and mask) of the next one, and every row is a decision that counts. The horizon is a
failure that the reward pays for, so no value is added where an episode is ``truncated``.
"""

import argparse
import sys

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn
from torch.distributions import Categorical

# The first simulation of the paper: a single task, so that learning shows within seconds.
TASK = {"task_suite": "sim-1"}

NUM_ENVS = 64
NUM_STEPS = 32  # of each robot between two updates
MINIBATCH = 512
EPOCHS = 4
LEARNING_RATE = 1e-3
GAMMA = 0.99
GAE_LAMBDA = 0.95
CLIP = 0.2
ENTROPY = 0.01
MAX_GRAD_NORM = 0.5


class Agent(nn.Module):
    """An actor and a critic."""

    def __init__(self, size: int, n_modes: int) -> None:
        super().__init__()
        self.actor = self.network(size, n_modes, gain=0.01)
        self.critic = self.network(size, 1, gain=1.0)

    @staticmethod
    def network(size: int, outputs: int, gain: float) -> nn.Sequential:
        """Two hidden layers, orthogonal weights."""
        layers = [nn.Linear(size, 64), nn.Linear(64, 64), nn.Linear(64, outputs)]
        for layer, scale in zip(layers, (2**0.5, 2**0.5, gain), strict=True):
            nn.init.orthogonal_(layer.weight, scale)
            nn.init.zeros_(layer.bias)
        return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])

    def policy(self, obs: torch.Tensor, mask: torch.Tensor) -> Categorical:
        """The distribution over the modes of the mask; the others have probability 0."""
        logits = self.actor(obs).masked_fill(~mask, torch.finfo(torch.float32).min)
        return Categorical(logits=logits)

    def value(self, obs: torch.Tensor) -> torch.Tensor:
        """The expected return."""
        return self.critic(obs).squeeze(-1)


def entropy(policy: Categorical) -> torch.Tensor:
    """The entropy; modes of probability 0 add nothing."""
    return -(policy.probs * policy.logits.clamp(min=-50.0)).sum(-1).mean()


def main() -> None:
    """Learns, and fails unless the return rose."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=60_000, help="decisions to learn from")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)

    envs = gymnasium.make_vec(
        "snake_env:SnakeModeSelection-v0",
        num_envs=NUM_ENVS,
        autoreset_mode=AutoresetMode.SAME_STEP,
        **TASK,
    )
    size, n_modes = envs.single_observation_space.shape[0], int(envs.single_action_space.n)
    agent = Agent(size, n_modes)
    optimizer = torch.optim.Adam(agent.parameters(), lr=LEARNING_RATE, eps=1e-5)

    obs = torch.zeros(NUM_STEPS, NUM_ENVS, size)
    masks = torch.zeros(NUM_STEPS, NUM_ENVS, n_modes, dtype=torch.bool)
    actions = torch.zeros(NUM_STEPS, NUM_ENVS, dtype=torch.long)
    logprobs, rewards, ends, values = (torch.zeros(NUM_STEPS, NUM_ENVS) for _ in range(4))

    returns, running = [], np.zeros(NUM_ENVS)  # of whole episodes
    observation, info = envs.reset(seed=args.seed)
    updates = max(1, args.steps // (NUM_STEPS * NUM_ENVS))
    for update in range(updates):
        optimizer.param_groups[0]["lr"] = LEARNING_RATE * (1.0 - update / updates)
        for t in range(NUM_STEPS):
            obs[t] = torch.from_numpy(observation)
            masks[t] = torch.from_numpy(info["action_mask"].astype(bool))
            with torch.no_grad():
                policy = agent.policy(obs[t], masks[t])
                actions[t] = policy.sample()
                logprobs[t] = policy.log_prob(actions[t])
                values[t] = agent.value(obs[t])
            observation, reward, terminated, truncated, info = envs.step(actions[t].numpy())
            running += reward
            done = terminated | truncated
            returns += running[done].tolist()
            running[done] = 0.0
            rewards[t], ends[t] = torch.from_numpy(reward), torch.from_numpy(done)

        # Generalised advantage estimation; nothing flows back over an episode's end.
        advantages = torch.zeros_like(rewards)
        with torch.no_grad():
            next_value = agent.value(torch.from_numpy(observation))
        advantage = torch.zeros(NUM_ENVS)
        for t in reversed(range(NUM_STEPS)):
            goes_on = 1.0 - ends[t]
            delta = rewards[t] + GAMMA * next_value * goes_on - values[t]
            advantage = delta + GAMMA * GAE_LAMBDA * goes_on * advantage
            advantages[t], next_value = advantage, values[t]
        targets = advantages + values

        flat = [x.flatten(0, 1) for x in (obs, masks, actions, logprobs, advantages, targets)]
        for _ in range(EPOCHS):
            for rows in torch.randperm(NUM_STEPS * NUM_ENVS).split(MINIBATCH):
                b_obs, b_mask, b_action, b_logprob, b_advantage, b_target = (x[rows] for x in flat)
                policy = agent.policy(b_obs, b_mask)
                ratio = (policy.log_prob(b_action) - b_logprob).exp()
                b_advantage = (b_advantage - b_advantage.mean()) / (b_advantage.std() + 1e-8)
                clipped = ratio.clamp(1.0 - CLIP, 1.0 + CLIP)
                policy_loss = -torch.min(ratio * b_advantage, clipped * b_advantage).mean()
                value_loss = (agent.value(b_obs) - b_target).square().mean()
                loss = policy_loss + 0.5 * value_loss - ENTROPY * entropy(policy)
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), MAX_GRAD_NORM)
                optimizer.step()
    envs.close()

    before, after = float(np.mean(returns[:200])), float(np.mean(returns[-200:]))
    steps = updates * NUM_STEPS * NUM_ENVS
    print(f"masked PPO, {steps} steps: mean return {before:.2f} -> {after:.2f}")
    if len(returns) < 400 or after < before + 0.2:
        sys.exit("the return did not rise")


if __name__ == "__main__":
    main()
