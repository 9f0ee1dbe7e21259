"""The models that ship: each is what its manifest says, has a card, and decides well."""

import json
import re
from importlib.resources import files
from pathlib import Path

import pytest

from snake_env import SnakeParams, load_policy
from snake_env.networks.model_file import read_model
from snake_env.sim.observation import observation_size
from snake_env.sim.tasks import load_tasks
from tests.support.commands import python
from tests.support.evaluations import evaluated

FOLDER = Path(str(files("snake_env") / "pretrained"))
MODELS = sorted(path.stem for path in FOLDER.glob("*.safetensors"))
POLICIES = [name for name in MODELS if not name.startswith("value")]


LEAST = {"paper": 0.95, "narrow": 0.8, "hardware": 0.85, "six": 0.55, "ten": 0.95}
"""Shares of tasks that raw policies solve at least, by robot."""


def _robot(name: str) -> str:
    return name.partition("-")[2] or "paper"


def test_models__ship_for_each_robot() -> None:
    assert {_robot(name) for name in MODELS} == set(LEAST)
    for robot in LEAST:
        suffix = "" if robot == "paper" else f"-{robot}"
        assert {f"ppo{suffix}", f"value{suffix}"} <= set(MODELS)
    assert {path.name for path in FOLDER.iterdir()} == {
        f"{name}.{suffix}" for name in MODELS for suffix in ("safetensors", "md")
    }


@pytest.mark.parametrize("name", MODELS)
def test_model__tells_how_it_was_made(name: str) -> None:
    model = read_model(FOLDER / f"{name}.safetensors")
    card = (FOLDER / f"{name}.md").read_text()
    made = model.made
    assert card.startswith(f"# {name}\n")
    assert f"`{made['command']}`" in card
    assert f"| seed | {made['seed'] if 'stages' in made else made['config']['seed']} |" in card
    assert model.network.sizes[0] == observation_size(model.params.n_joints)
    assert made["versions"]["torch"]
    assert not model.params.differences(SnakeParams.preset(_robot(name)))
    if "stages" in made:  # a recipe's: anyone can make it again
        assert re.fullmatch("[0-9a-f]{40}", made["git"])
        assert made["budget"] == "full"
        today = {"value", "imitate", "ppo", "dqn"}
        assert set(made["stages"]) in (today, today | {"critic", "harvest"})  # or as it was before


@pytest.mark.parametrize("name", POLICIES)
def test_policy__solves_nearly_all_that_its_robot_can_do(name: str) -> None:
    robot = _robot(name)
    params = SnakeParams.preset(robot)
    suite = load_tasks("random:60:4711", params)
    rows = evaluated(name.partition("-")[0], suite, params)
    solved = sum(row["outcome"] == "success" for row in rows) / len(rows)
    assert solved > LEAST[robot]
    assert sum(row["rollouts"] for row in rows) == 0


def test_policies__need_no_torch() -> None:
    code = (
        "import sys; from snake_env import *; p = SnakeParams(); "
        "s = load_tasks('sim-1', p).initial(0, p); "
        "print([load_policy(n, p).select_mode(s) for n in ('imitate', 'ppo', 'dqn', 'ppo+shield')]);"
        "sys.exit('torch' in sys.modules)"
    )
    done = python("-c", code)
    state = load_tasks("sim-1", SnakeParams()).initial(0, SnakeParams())
    names = ("imitate", "ppo", "dqn", "ppo+shield")
    assert json.loads(done.stdout) == [load_policy(name).select_mode(state) for name in names]
