"""Private parts of other libraries that the project uses, by name: their next version may lack them."""

import ast
import importlib
import inspect
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import ROOT

PACKAGES = ("snake_env", "agents", "train", "evaluate", "harness", "benchmarks")
FOREIGN = {
    "stable_baselines3.common.base_class.BaseAlgorithm": [
        *(
            "_current_progress_remaining",
            "_last_obs",
            "_n_updates",
            "_setup_learn",
            "_total_timesteps",
            "_vec_normalize_env",
        ),
        *("_update_current_progress_remaining", "_update_learning_rate"),
    ],
    "stable_baselines3.common.off_policy_algorithm.OffPolicyAlgorithm": ["_sample_action"],
    "stable_baselines3.common.policies.ActorCriticPolicy": [
        "_build_mlp_extractor",
        "_get_action_dist_from_latent",
    ],
    "stable_baselines3.common.policies.BaseModel": ["_update_features_extractor"],
    "stable_baselines3.common.vec_env.base_vec_env.VecEnv": [
        *("_get_indices", "_options", "_reset_options", "_reset_seeds", "_seeds")
    ],
    "stable_baselines3.dqn.dqn.DQN": ["_n_calls"],
    "stable_baselines3.dqn.policies.DQNPolicy": ["_build"],
}
"""By class: attributes that are read or set, and methods that are called or replaced."""


def _trees() -> Iterator[tuple[Path, ast.Module]]:
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            yield path, ast.parse(path.read_text())


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def _own() -> set[str]:
    """Private names that the project's own classes and modules define."""
    own = set()
    for _, tree in _trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                own.add(node.name)
            elif isinstance(node, ast.Name | ast.alias):
                own.add(node.id if isinstance(node, ast.Name) else node.asname or node.name)
            elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                if isinstance(node.value, ast.Name) and node.value.id == "self":
                    own.add(node.attr)
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                own.add(node.target.id)
    return own


def test_every_foreign_private_part__is_named_here() -> None:
    own, known = _own(), {name for names in FOREIGN.values() for name in names}
    used: dict[str, Path] = {}
    for path, tree in _trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and _is_private(node.attr):
                used.setdefault(node.attr, path)
    unknown = {name: path.name for name, path in used.items() if name not in own | known}
    assert unknown.keys() <= {"_exit"}  # of os: documented
    replaced = {"_build", "_build_mlp_extractor", "_get_action_dist_from_latent", "_sample_action"}
    assert known <= used.keys() | replaced


@pytest.mark.parametrize("place", FOREIGN)
def test_foreign_private_parts__are_there(place: str) -> None:
    module, _, name = place.rpartition(".")
    owner = getattr(importlib.import_module(module), name)
    source = "".join(inspect.getsource(each) for each in owner.__mro__ if each.__module__ == module)
    for part in FOREIGN[place]:
        assert hasattr(owner, part) or re.search(rf"self\.{part}\b", source), part


def test_their_next_major_versions__are_not_installed_unseen() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"]["train"]]
    bounds = {text.partition(">=")[0]: text.partition(",")[2] for text in wanted}
    assert bounds["stable-baselines3"] == "<3"
    assert bounds["gymnasium"] == "<2"
    assert bounds["llvmlite"] == "<1"
