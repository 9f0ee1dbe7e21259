"""Cost-sensitive imitation: a network learns from what every mode would cost, in its own states.

Round by round the student plays, the teacher says what each mode of the states on the way would cost
(DAgger), and the student learns to prefer cheap modes. A mode's regret is what it costs more than the
best one. The loss is the student's expected regret, and for its gradient where the student is sure of
a bad mode, the cross-entropy with a soft minimum of the regrets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from agents.checks import check_hidden, check_positive
from agents.mlp import build, from_numpy, linear_layers, to_numpy
from agents.symmetry import mirror
from agents.teacher import Decisions
from snake_env.modes import mode_table
from snake_env.network import Network
from snake_env.observation import observation_size, observe
from snake_env.params import SnakeParams


@dataclass(frozen=True)
class Fit:
    """How the network is fitted to the decisions."""

    hidden: tuple[int, ...] = (384, 384)
    """Sizes of the hidden layers."""
    epochs: int = 4
    """Passes over the decisions of the window, in each round."""
    batch_size: int = 512
    """Decisions in a gradient step."""
    learning_rate: float = 1e-3
    """Learning rate of Adam in the first round; falls to a twentieth of it by the last."""
    temperature: float = 0.3
    """Of the soft minimum [intervals]."""
    cross_entropy: float = 0.3
    """Weight of the cross-entropy beside the expected regret."""
    violation: float = 30.0
    """Regret of an infeasible mode, and the largest of a feasible one [intervals]."""

    def check(self) -> None:
        """Raises InvalidInputError where a value can't be used."""
        check_positive(self, "epochs", "batch_size", "learning_rate", "temperature", "violation")
        check_hidden(self.hidden)


@dataclass(frozen=True, eq=False)
class Lessons:
    """What the student learns from.

    Attributes:
        observations: Shape (N, observation_size).
        regret: What each mode costs more than the best, shape (N, n_modes) [intervals]; negative
            where it can't be chosen at all.
    """

    observations: NDArray[np.float32]
    regret: NDArray[np.float16]


def lessons(decisions: Decisions, violation: float, params: SnakeParams) -> Lessons:
    """The lessons in decisions; those without a feasible mode teach nothing.

    Args:
        decisions: States and what every mode costs.
        violation: Regret of an infeasible mode, and the largest of a feasible one [intervals].
        params: The constants.
    """
    chosen = decisions.take(np.flatnonzero(decisions.feasible.any(axis=1)))
    regret = chosen.cost_to_go - chosen.cost_to_go.min(axis=1, keepdims=True)
    regret = np.where(chosen.mask, np.minimum(regret, violation), -1.0)
    return Lessons(observe(chosen.states, params), regret.astype(np.float16))


def fit(
    network: Network | None,
    parts: Sequence[Lessons],
    how: Fit,
    learning_rate: float,
    n_joints: int,
    seed: int,
) -> tuple[Network, dict[str, float]]:
    """Fits a network to lessons, each state and its mirror image in turn.

    Args:
        network: Where to begin; None: anew.
        parts: The lessons.
        how: The method's options.
        learning_rate: That of this round.
        n_joints: Joints of the robot.
        seed: Decides the order of the batches, and where a new network begins.

    Returns:
        The network; and of the last pass the mean regret of the preferred mode [intervals], and how
        often that mode is infeasible.
    """
    torch.manual_seed(seed)
    outputs = len(mode_table(n_joints))
    module = (
        build([observation_size(n_joints), *how.hidden, outputs])
        if network is None
        else from_numpy(network)
    )
    order, sign = (torch.from_numpy(part) for part in mirror(n_joints))
    x = torch.from_numpy(np.concatenate([part.observations for part in parts]))
    regret = torch.from_numpy(np.concatenate([part.regret for part in parts]))
    size = min(how.batch_size, len(x))
    optimizer = torch.optim.Adam(module.parameters(), learning_rate)
    figures = {"regret": 0.0, "infeasible": 0.0}
    for epoch in range(how.epochs):
        batches = torch.randperm(len(x))[: len(x) // size * size].reshape(-1, size)
        figures = dict.fromkeys(figures, 0.0)
        for k, rows in enumerate(batches):
            given = x[rows] if (k + epoch) % 2 == 0 else x[rows][:, order] * sign
            costs = regret[rows].float()
            closed = costs < 0.0
            logits = module(given).masked_fill(closed, -1e9)
            log_policy = torch.log_softmax(logits, dim=1)
            policy = log_policy.exp()
            wanted = torch.softmax(
                (-costs / how.temperature).masked_fill(closed | (costs >= how.violation), -1e9),
                dim=1,
            )
            expected = (policy * costs.clamp(min=0.0)).sum(dim=1).mean()
            loss = expected - how.cross_entropy * (wanted * log_policy).sum(dim=1).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            preferred = costs.gather(1, logits.argmax(dim=1, keepdim=True))
            figures["regret"] += float(preferred.mean()) / len(batches)
            figures["infeasible"] += float((preferred >= how.violation).float().mean()) / len(
                batches
            )
    return to_numpy(linear_layers(module)), figures
