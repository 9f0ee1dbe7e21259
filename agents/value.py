"""The value network: how many intervals a state still needs, learned by policy iteration.

Each generation plays random tasks. An episode first explores: for some intervals its choices are those
of the value with noise. From then on it is greedy, and what it needs from each state to the end is
exactly what that state is worth under the present value. The next value is fitted to these returns, or
to lambda-returns (TD(lambda), Sutton and Barto, section 12.1), which trust the present value for what
lies further ahead: how long an episode takes hangs on tiny differences, so returns are noisy.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents.checks import check_device, check_hidden, check_not_negative, check_positive
from agents.mlp import Track, batches, bfloat16_matmul, build, from_numpy, to_numpy, untracked
from agents.muon import Descent
from snake_env.networks.network import Network
from snake_env.sb3.images import CanonicalImage
from snake_env.sb3.model_writer import linear_layers
from snake_env.sim.observation import observation_size


@dataclass(frozen=True)
class Fit:
    """How the network is fitted to a generation's returns."""

    hidden: tuple[int, ...] = (256, 256, 128)
    """Sizes of the hidden layers."""
    epochs: int = 4
    """Passes over the returns of the window."""
    batch_size: int = 2048
    """Returns in a gradient step."""
    learning_rate: float = 8e-3
    """Learning rate of Muon, and of Adam for biases, in the first generation; it falls to a hundredth
    within each, and the largest to a twentieth by the last."""
    weight_decay: float = 0.2
    """Weight decay of Muon."""
    device: str = "cpu"
    """Where the network is fitted: cpu, or cuda."""

    def check(self) -> None:
        """Raises InvalidInputError where a value can't be used."""
        check_positive(self, "epochs", "batch_size", "learning_rate")
        check_not_negative(self, "weight_decay")
        check_hidden(self.hidden)
        check_device(self.device)


@bfloat16_matmul()
def fit(
    network: Network | None,
    observations: NDArray[np.float32],
    intervals: NDArray[np.float32],
    how: Fit,
    learning_rate: float,
    n_joints: int,
    seed: int,
    *,
    track: Track = untracked,
) -> tuple[Network, float]:
    """Fits a network to returns.

    Args:
        network: The initial network; None: random weights.
        observations: Shape (N, observation_size).
        intervals: Shape (N,).
        how: The method's options.
        learning_rate: The largest in this generation.
        n_joints: Joints of the robot.
        seed: Decides the order of the batches, and where a new network begins.
        track: Shows how far it has come.

    Returns:
        The network and its mean absolute error in the last pass [intervals].
    """
    torch.manual_seed(seed)
    if network is None:
        module = build([observation_size(n_joints), *how.hidden, 1])
        last = module[-1]
        assert isinstance(last, torch.nn.Linear)
        torch.nn.init.constant_(last.bias, float(np.median(intervals)))
    else:
        module = from_numpy(network)
    seeing = nn.Sequential(CanonicalImage(observations.shape[1]), module).to(how.device)
    x, y = (torch.from_numpy(part).to(how.device) for part in (observations, intervals))
    size = min(how.batch_size, len(x))
    steps = len(x) // size  # in a pass
    descent = Descent(module, learning_rate, how.epochs * steps, how.weight_decay)
    last_pass: deque[torch.Tensor] = deque(maxlen=steps)
    for rows in track(batches(len(x), size, how.epochs, how.device), how.epochs * steps):
        estimate = seeing(x[rows])[:, 0]
        loss = torch.nn.functional.huber_loss(estimate, y[rows], delta=3.0)
        descent.step(loss)
        last_pass.append((estimate.detach() - y[rows]).abs().mean())
    return to_numpy(linear_layers(module), how.learning_rate), float(
        torch.stack(tuple(last_pass)).mean()
    )
