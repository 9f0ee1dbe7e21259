"""The same bits on processors with narrower vectors."""

import platform
from pathlib import Path

import pytest

from tests.support.commands import python

_PROCESSOR = """
import sys
import llvmlite.binding as llvm
name, features = sys.argv[1:]
if name != "native":
    class Given:
        def flatten(self):
            return features
    llvm.get_host_cpu_name = lambda: name
    llvm.get_host_cpu_features = Given
"""
_ROBOT = """
from snake_env import ModeTable, SnakeParams, load_tasks, predict
from snake_env.sim.masks import action_masks
from snake_env.sim.observation import observe
from snake_env.state import StateBatch
params = SnakeParams()
suite = load_tasks("random:3:5", params)
for task in range(3):
    state = suite.initial(task, params)
    prediction = predict(state, ModeTable(8).valid(1), params)
    batch = StateBatch.stack([state])
    seen = observe(batch, params), action_masks(batch, params, "instant")
    for array in (prediction.phi, prediction.cost, prediction.d_min, prediction.j, *seen):
        sys.stdout.write(array.tobytes().hex() + "\\n")
"""
_NETWORK = """
import numpy as np
from snake_env.kernel.perceptron import Perceptron
rng = np.random.default_rng(1)
draw = lambda *shape: rng.normal(size=shape).astype(np.float32)
network = Perceptron([draw(99, 70), draw(70, 33), draw(33, 5)], [draw(70), draw(33), draw(5)])
sys.stdout.write(network(draw(6, 99)).tobytes().hex())
"""


def _results(script: str, processor: str, features: str, cache: Path) -> str:
    words = ("-c", _PROCESSOR + script, processor, features)
    return python(*words, SNAKE_ENV_CACHE_DIR=str(cache)).stdout


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="names x86 processors")
@pytest.mark.parametrize(
    ("script", "processor", "features"),
    [
        (_ROBOT, "x86-64", ""),
        (_ROBOT, "x86-64-v3", ""),
        (_ROBOT, "x86-64-v3", "+avx,+avx2,+fma"),
        (_NETWORK, "x86-64-v3", "+avx,+avx2,+fma"),  # without fma, sums are rounded otherwise
    ],
)
def test_results__do_not_depend_on_the_vector_width(
    script: str, processor: str, features: str, tmp_path: Path
) -> None:
    found = _results(script, processor, features, tmp_path)
    assert found
    assert found == _results(script, "native", "", tmp_path)
