"""The value network: how many intervals a state still needs, learned by policy iteration.

Each generation plays random tasks. An episode first explores: for some intervals its choices are those
of the value with noise. From then on it is greedy, and what it needs from each state to the end is
exactly what that state is worth under the present value. The next value is fitted to these returns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from agents.checks import check_hidden, check_positive
from agents.mlp import build, from_numpy, linear_layers, to_numpy
from snake_env.errors import InvalidInputError
from snake_env.model_file import Model
from snake_env.network import Network
from snake_env.observation import observation_size, observe
from snake_env.params import SnakeParams
from snake_env.search import best_of_each, expand
from snake_env.state import StateBatch
from snake_env.symmetry import mirror
from snake_env.tasks import random_tasks
from snake_env.value import NetworkValue, PhaseValue, ValueFunction

FAILURE = 30.0
"""What a state is worth from which the target is not reached [intervals]."""
_EXPLORED = 10  # an episode explores for fewer intervals than this
_AT_ONCE = 0.25  # share of episodes that don't explore at all
_NOISE = (0.3, 3.0)  # least and largest scale of the noise [intervals]


@dataclass(frozen=True)
class Fit:
    """How the network is fitted to a generation's returns."""

    hidden: tuple[int, ...] = (256, 256, 128)
    """Sizes of the hidden layers."""
    epochs: int = 4
    """Passes over the returns of the window."""
    batch_size: int = 512
    """Returns in a gradient step."""
    learning_rate: float = 1e-3
    """Largest learning rate of AdamW in the first generation; falls to a twentieth by the last."""
    weight_decay: float = 1e-4
    """Weight decay of AdamW."""

    def check(self) -> None:
        """Raises InvalidInputError where a value can't be used."""
        check_positive(self, "epochs", "batch_size", "learning_rate")
        if not self.weight_decay >= 0.0:
            raise InvalidInputError("weight_decay", self.weight_decay, "zero or a positive number")
        check_hidden(self.hidden)


@dataclass(frozen=True, eq=False)
class Play:
    """Episodes to play: a shard of a generation.

    Attributes:
        seed: The run's seed.
        generation: Which generation this is.
        part: Which shard of it.
        count: Number of episodes.
        network: The present value; None: minus the potential of the reward.
        params: The constants.
    """

    seed: int
    generation: int
    part: int
    count: int
    network: Network | None
    params: SnakeParams


@dataclass(frozen=True, eq=False)
class Returns:
    """What states were worth.

    Attributes:
        part: The shard that they come from.
        observations: Shape (N, observation_size).
        intervals: Greedy intervals from there to the target, or :data:`FAILURE`, shape (N,).
        greedy: Episodes that did not explore.
        solved: Those of them that reached the target.
        time: Their intervals, all together.
    """

    part: int
    observations: NDArray[np.float32]
    intervals: NDArray[np.float32]
    greedy: int
    solved: int
    time: int


def value_of(network: Network | None, params: SnakeParams) -> ValueFunction:
    """The value function of a network; without one, minus the potential of the reward."""
    if network is None:
        return PhaseValue(params)
    return NetworkValue(Model("value", params.n_joints, network), params)


def play(shard: Play) -> Returns:
    """Plays a shard's episodes side by side."""
    params, count = shard.params, shard.count
    key = (shard.generation, shard.part)
    streams = [np.random.SeedSequence(shard.seed, spawn_key=(*key, k)) for k in range(count)]
    rng = np.random.default_rng(np.random.SeedSequence(shard.seed, spawn_key=(*key, count)))
    phi0, target = random_tasks([np.random.default_rng(stream) for stream in streams], params)
    value = value_of(shard.network, params)
    explores = np.where(rng.random(count) < _AT_ONCE, 0, rng.integers(_EXPLORED, size=count))
    scale = np.exp(rng.uniform(*np.log(_NOISE), count))
    states, task = StateBatch.initial(phi0, target, params), np.arange(count)
    end = np.full(count, -1)
    visited: list[tuple[NDArray[np.float32], NDArray[np.int64]]] = []
    depth, longest = 0, _EXPLORED + int(FAILURE)
    while len(task) and depth < longest:
        visited.append((observe(states, params), task))
        tree = expand(states, params)
        noisy = explores[task] > depth
        noise = rng.gumbel(size=len(tree.mode)) * scale[task[tree.parent]]
        rank = value(tree.states) - np.where(noisy[tree.parent], noise, 0.0)
        chosen = best_of_each(tree.parent, rank)
        states, task = tree.states.take(chosen), task[tree.parent[chosen]]
        depth += 1
        reached = states.phase > params.n_joints
        end[task[reached]] = depth
        states, task = states.take(np.flatnonzero(~reached)), task[~reached]
    observations = np.concatenate([rows for rows, _ in visited])
    of = np.concatenate([tasks for _, tasks in visited])
    when = np.repeat(np.arange(len(visited)), [len(tasks) for _, tasks in visited])
    kept = when >= explores[of]
    left = np.where(end[of] >= 0, np.minimum(end[of] - when, FAILURE), FAILURE)
    greedy = explores == 0
    solved = greedy & (end >= 0)
    return Returns(
        part=shard.part,
        observations=observations[kept],
        intervals=left[kept].astype(np.float32),
        greedy=int(greedy.sum()),
        solved=int(solved.sum()),
        time=int(end[solved].sum()),
    )


def fit(
    network: Network | None,
    observations: NDArray[np.float32],
    intervals: NDArray[np.float32],
    how: Fit,
    learning_rate: float,
    n_joints: int,
    seed: int,
) -> tuple[Network, float]:
    """Fits a network to returns, each state and its mirror image in turn.

    Args:
        network: Where to begin; None: anew.
        observations: Shape (N, observation_size).
        intervals: Shape (N,).
        how: The method's options.
        learning_rate: The largest in this generation.
        n_joints: Joints of the robot.
        seed: Decides the order of the batches, and where a new network begins.

    Returns:
        The network and its mean absolute error in the last pass [intervals].
    """
    torch.manual_seed(seed)
    if network is None:
        module = build([observation_size(n_joints), *how.hidden, 1])
        torch.nn.init.constant_(module[-1].bias, float(np.median(intervals)))
    else:
        module = from_numpy(network)
    order, sign = (torch.from_numpy(part) for part in mirror(n_joints))
    x, y = torch.from_numpy(observations), torch.from_numpy(intervals)
    size = min(how.batch_size, len(x))
    steps = how.epochs * (len(x) // size)
    optimizer = torch.optim.AdamW(module.parameters(), learning_rate, weight_decay=how.weight_decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, learning_rate, total_steps=steps + 1, pct_start=0.1
    )
    error = 0.0
    for epoch in range(how.epochs):
        batches = torch.randperm(len(x))[: len(x) // size * size].reshape(-1, size)
        error = 0.0
        for k, rows in enumerate(batches):
            given = x[rows] if (k + epoch) % 2 == 0 else x[rows][:, order] * sign
            estimate = module(given)[:, 0]
            loss = torch.nn.functional.huber_loss(estimate, y[rows], delta=3.0)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            error += float((estimate.detach() - y[rows]).abs().mean()) / len(batches)
    return to_numpy(linear_layers(module)), error
