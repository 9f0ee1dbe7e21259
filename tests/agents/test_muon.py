"""Muon: what the steps of the fits are made of."""

import copy

import numpy as np
import pytest
import torch
from torch import nn

from agents.muon import Muon, orthogonalised


@pytest.mark.parametrize("shape", [(40, 25), (25, 40), (30, 30), (1, 8)])
def test_orthogonalised__turns_every_direction_alike(shape: tuple[int, int]) -> None:
    torch.manual_seed(3)
    u, _, v = torch.linalg.svd(torch.randn(shape), full_matrices=False)
    matrix = u @ torch.diag(torch.linspace(0.2, 3.0, min(shape))) @ v
    result = orthogonalised(matrix)
    assert result.dtype == torch.float32
    values = torch.linalg.svdvals(result)
    assert values.min() > 0.6
    assert values.max() < 1.3
    assert torch.diagonal(u.T @ result @ v.T).min() > 0.6  # in its own directions, not others


@pytest.mark.parametrize("shape", [(12, 20), (20, 12)])
def test_steps__are_those_of_the_formula(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(6)
    gradients = rng.normal(size=(4, *shape))
    wanted = rng.normal(size=shape)
    weight = nn.Parameter(torch.tensor(wanted, dtype=torch.float32))
    optimizer = Muon([weight], 0.1, weight_decay=0.3)
    kept = np.zeros(shape)
    for gradient in gradients:
        weight.grad = torch.tensor(gradient, dtype=torch.float32)
        optimizer.step()
        kept = 0.95 * kept + 0.05 * gradient
        u, values, v = np.linalg.svd(0.05 * gradient + 0.95 * kept, full_matrices=False)
        values = values / np.sqrt((values**2).sum())
        for _ in range(5):
            values = 3.4445 * values - 4.775 * values**3 + 2.0315 * values**5
        wanted = wanted * (1.0 - 0.1 * 0.3) - 0.1 * 0.2 * np.sqrt(20) * (u * values) @ v
    np.testing.assert_allclose(weight.detach().numpy(), wanted, atol=1e-4)


@pytest.mark.parametrize("decay", [0.0, 0.5])
def test_muon__is_that_of_pytorch(decay: float) -> None:
    theirs = getattr(torch.optim, "Muon", None)
    if theirs is None:
        pytest.skip("this PyTorch has none yet")
    torch.manual_seed(4)
    ours_net, x, y = nn.Linear(20, 12, bias=False), torch.randn(64, 20), torch.randn(64, 12)
    their_net, begun = copy.deepcopy(ours_net), ours_net.weight.detach().clone()
    ours = Muon(ours_net.parameters(), 0.02, decay)
    reference = theirs(
        their_net.parameters(), 0.02, weight_decay=decay, adjust_lr_fn="match_rms_adamw"
    )
    for _ in range(20):
        for network, optimizer in ((ours_net, ours), (their_net, reference)):
            optimizer.zero_grad()
            (network(x) - y).square().mean().backward()
            optimizer.step()
    apart, way = ours_net.weight - their_net.weight, their_net.weight - begun
    assert apart.norm() < 0.03 * way.norm()  # theirs rounds to eight bits


def test_muon__follows_its_learning_rate() -> None:
    torch.manual_seed(5)
    network = nn.Linear(9, 4, bias=False)
    before = network.weight.detach().clone()
    optimizer = Muon(network.parameters(), 1.0)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1e-3, 1.0, total_iters=10)
    network(torch.randn(5, 9)).square().sum().backward()
    optimizer.step()
    schedule.step()
    step = (network.weight - before).norm()  # 0.2 sqrt(9) of singular values near one, 4 of them
    assert 0.6 * 1.2e-3 < step < 1.3 * 1.2e-3
