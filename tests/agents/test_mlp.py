"""What training does to PyTorch's settings: they are as before once it is over."""

from collections.abc import Iterable

import numpy as np
import pytest
import torch

from agents.mlp import bfloat16_matmul
from agents.value import Fit, fit
from snake_env.errors import InvalidInputError
from snake_env.sim.observation import observation_size


@bfloat16_matmul()
def _interrupted() -> None:
    assert torch.get_float32_matmul_precision() == "medium"
    raise InvalidInputError("precision", "medium", "an error in the middle of a fit")


@pytest.mark.parametrize("before", ["highest", "high"])
def test_bfloat16_matmul__leaves_the_precision_as_it_was(before: str) -> None:
    torch.set_float32_matmul_precision(before)
    try:
        with pytest.raises(InvalidInputError):
            _interrupted()
        assert torch.get_float32_matmul_precision() == before
    finally:
        torch.set_float32_matmul_precision("highest")


def test_fits__use_bfloat16_matmul_every_time() -> None:
    seen = []

    def track(batches: Iterable[torch.Tensor], total: int) -> Iterable[torch.Tensor]:
        for batch in batches:
            seen.append(torch.get_float32_matmul_precision())
            yield batch

    x = np.random.default_rng(0).normal(size=(32, observation_size(5))).astype(np.float32)
    how = Fit(hidden=(4,), epochs=1, batch_size=16)
    for _ in range(2):
        fit(None, x, np.ones(32, np.float32), how, 1e-3, 5, seed=0, track=track)
        assert torch.get_float32_matmul_precision() == "highest"
    assert seen == ["medium"] * 4
