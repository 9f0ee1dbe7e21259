"""Cost-sensitive imitation: a network learns from what every mode would cost, in its own states.

Round by round the student plays, the teacher says what each mode of the states on the way would cost
(DAgger), and the student learns to prefer cheap modes. A mode's regret is what it costs more than the
best one. The loss is the student's expected regret; for its gradient where the student is sure of a
bad mode, the cross-entropy with a soft minimum of the regrets; and the error of the action values, as
the logits are those of a soft maximum of action values: PPO and DQN can both begin with them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents.checks import check_device, check_hidden, check_not_negative, check_positive
from agents.failures import failure_value
from agents.labels import REWARD, Decisions
from agents.mlp import Track, batches, bfloat16_matmul, build, from_numpy, to_numpy, untracked
from agents.muon import Descent
from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.networks.model_file import REWARD_PER_LOGIT
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.sb3.images import BothImages, MeanOfBoth
from snake_env.sb3.model_writer import linear_layers
from snake_env.sim.array_file import ArrayFileError, read_arrays
from snake_env.sim.observation import observation_size, observe

_LARGEST = 32 * 2**30  # bytes of an array of labels


@dataclass(frozen=True)
class Fit:
    """How the network is fitted to the decisions."""

    hidden: tuple[int, ...] = (384, 384, 192)
    """Sizes of the hidden layers."""
    epochs: int = 2
    """Passes over all decisions so far, in each round but the last."""
    last_epochs: int = 8
    """Passes in the last round."""
    batch_size: int = 1024
    """Decisions per gradient step."""
    learning_rate: float = 3e-3
    """Learning rate of Muon, and of Adam for biases; falls to a hundredth of it in each round."""
    weight_decay: float = 0.2
    """Weight decay of Muon; it prevents overfitting."""
    cross_entropy: float = 1.0
    """Weight of the cross-entropy, which is added to the expected regret."""
    values: float = 10.0
    """Weight of the action-value loss."""
    violation: float = 100.0
    """Regret of infeasible modes, and cap for feasible ones [intervals]."""
    device: str = "cpu"
    """Where the network is fitted: cpu, or cuda."""

    def check(self) -> None:
        """Raises InvalidInputError where a value can't be used."""
        check_positive(self, "epochs", "last_epochs", "batch_size", "learning_rate")
        check_positive(self, "violation")
        check_not_negative(self, "weight_decay", "cross_entropy", "values")
        check_hidden(self.hidden)
        check_device(self.device)


@dataclass(frozen=True, eq=False)
class Dataset:
    """Observations and labels that the student is fitted to.

    Attributes:
        observations: Shape (N, observation_size).
        cost: Intervals to the target with each mode, shape (N, n_modes); infinite where it is
            infeasible, negative where it can't be chosen or was not asked about.
    """

    observations: NDArray[np.float32]
    cost: NDArray[np.float16]


def dataset(decisions: Decisions, params: SnakeParams) -> Dataset:
    """The dataset of some decisions; those without a feasible mode are left out."""
    chosen = decisions.take(np.flatnonzero(decisions.feasible.any(axis=1)))
    cost = np.where(chosen.mask, chosen.cost_to_go, -1.0)
    return Dataset(observe(chosen.states, params), cost.astype(np.float16))


def read_datasets(run: Path) -> list[Dataset]:
    """The datasets that a run of ``train imitate`` has collected, round by round.

    Raises:
        InvalidInputError: They are damaged.
    """
    parts = []
    for path in sorted(run.glob("labels-*.npz")):
        try:
            arrays = read_arrays(path, "observations", "cost", most=_LARGEST)
            observations, cost = arrays["observations"], arrays["cost"]
            if observations.ndim != 2 or cost.ndim != 2 or len(observations) != len(cost):
                raise ArrayFileError("its arrays have inconsistent lengths")
        except ArrayFileError as error:
            expected = f"undamaged labels ({error}; --overwrite begins again)"
            raise InvalidInputError("labels", str(path), expected) from None
        parts.append(Dataset(observations.astype(np.float32), cost.astype(np.float16)))
    return parts


@bfloat16_matmul()
def fit(
    network: Network | None,
    parts: Sequence[Dataset],
    how: Fit,
    params: SnakeParams,
    seed: int,
    *,
    last: bool,
    track: Track = untracked,
) -> tuple[Network, dict[str, float]]:
    """Fits a network to labels: the mean of its outputs for state and mirror image.

    Args:
        network: The initial network; None: random weights.
        parts: The datasets.
        how: The method's options.
        params: The robot.
        seed: Decides the order of the batches, and where a new network begins.
        last: Whether it is the last round.
        track: Shows how far it has come.

    Returns:
        The network; and of the last pass the mean regret of the preferred mode [intervals], and how
        often that mode is infeasible.
    """
    torch.manual_seed(seed)
    n, least = params.n_joints, failure_value(params, REWARD)
    module = (
        build([observation_size(n), *how.hidden, len(mode_table(n))])
        if network is None
        else from_numpy(network.scaled(REWARD_PER_LOGIT))
    )
    images, mean = BothImages(observation_size(n)), MeanOfBoth()
    seeing = nn.Sequential(images, module, mean).to(how.device)
    x = torch.from_numpy(np.concatenate([part.observations for part in parts])).to(how.device)
    cost = torch.from_numpy(np.concatenate([part.cost for part in parts])).to(how.device)
    size, epochs = min(how.batch_size, len(x)), how.last_epochs if last else how.epochs
    steps = len(x) // size  # in a pass
    descent = Descent(module, how.learning_rate, epochs * steps, how.weight_decay)
    last_pass: deque[torch.Tensor] = deque(maxlen=steps)
    for rows in track(batches(len(x), size, epochs, how.device), epochs * steps):
        costs = cost[rows].float()
        values = seeing(x[rows]).masked_fill(costs < 0.0, -1e9)
        regret = _regret(costs, how)
        loss = _loss(values, costs, regret, how, least)
        descent.step(loss)
        last_pass.append(regret.gather(1, values.argmax(dim=1, keepdim=True))[:, 0])
    preferred = torch.stack(tuple(last_pass))
    broken = (preferred >= how.violation).float()
    figures = {
        "regret": float((preferred * (1.0 - broken)).mean()),
        "infeasible": float(broken.mean()),
    }
    fitted = to_numpy(linear_layers(module), how.learning_rate)
    return fitted.scaled(1.0 / REWARD_PER_LOGIT), figures


def _regret(costs: torch.Tensor, how: Fit) -> torch.Tensor:
    """What each mode costs more than the best [intervals]; negative where it can't be chosen."""
    closed = costs < 0.0
    best = costs.masked_fill(closed, torch.inf).min(dim=1, keepdim=True).values
    return (costs - best).clamp(max=how.violation).masked_fill(closed, -1.0)


def _loss(
    values: torch.Tensor, costs: torch.Tensor, regret: torch.Tensor, how: Fit, least: float
) -> torch.Tensor:
    """Expected regret of the logits, their cross-entropy, and the error of the values."""
    log_policy = torch.log_softmax(values / REWARD_PER_LOGIT, dim=1)
    out = (regret < 0.0) | (regret >= how.violation)
    gain = (REWARD.time * regret / REWARD_PER_LOGIT).masked_fill(out, -1e9)
    wanted = torch.softmax(gain, dim=1)
    expected = (log_policy.exp() * regret.clamp(min=0.0)).sum(dim=1).mean()
    cross_entropy = -(wanted * log_policy).sum(dim=1).mean()
    weight = torch.where(torch.isinf(costs), 0.3, 0.03 + torch.exp(-regret))  # near the best: most
    weight = weight.masked_fill(costs < 0.0, 0.0)
    error = torch.nn.functional.huber_loss(
        values, action_values(costs, least), reduction="none", delta=0.5
    )
    return (
        expected
        + how.cross_entropy * cross_entropy
        + how.values * (weight * error).sum() / weight.sum()
    )


def action_values(costs: torch.Tensor, least: float) -> torch.Tensor:
    """Costs as the reward of train ppo and dqn has them: the return with each mode, undiscounted.

    Args:
        costs: Intervals to the target with each mode; infinite where it is infeasible.
        least: What these are worth.
    """
    value = REWARD.success + REWARD.time * costs
    return torch.where(torch.isinf(costs), least, value)
