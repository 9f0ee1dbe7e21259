"""The same bits on processors with narrower vectors."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

_RUN = """
import sys
import llvmlite.binding as llvm
if sys.argv[1] != "native":
    class NoFeatures:
        def flatten(self):
            return ""
    llvm.get_host_cpu_name = lambda: sys.argv[1]
    llvm.get_host_cpu_features = NoFeatures
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
    seen = observe(batch, params), action_masks(batch, "instant", params)
    for array in (prediction.phi, prediction.cost, prediction.d_min, prediction.j, *seen):
        sys.stdout.write(array.tobytes().hex() + "\\n")
"""


def _results(processor: str, cache: Path) -> str:
    return subprocess.run(
        [sys.executable, "-c", _RUN, processor],
        env={**os.environ, "SNAKE_ENV_CACHE_DIR": str(cache)},
        check=True,
        capture_output=True,
        text=True,
    ).stdout


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="names x86 processors")
@pytest.mark.parametrize("processor", ["x86-64", "x86-64-v3"])
def test_results__do_not_depend_on_the_vector_width(processor: str, tmp_path: Path) -> None:
    assert _results(processor, tmp_path) == _results("native", tmp_path)
