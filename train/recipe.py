"""``python -m train recipe``: from random weights to policies, in one command."""

from __future__ import annotations

import dataclasses
import importlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from harness.engine import Engine
from harness.folder import Layout
from harness.provenance import arguments, command
from harness.robot import Robot
from snake_env.errors import InvalidInputError, UnknownNameError
from train.config import read_yaml, replaced
from train.ground import Ground
from train.jobs import Job, side_by_side
from train.models import comparison, ship
from train.run import Run, RunFolder
from train.validation import check_count

RECIPES = Path(__file__).parent.parent / "agents" / "recipes"
STAGES = {
    "value": "a value network, by policy iteration",
    "imitate": "a student, by imitation",
    "ppo": "the student, fine-tuned by PPO",
    "dqn": "the student, fine-tuned by DQN",
    "models": "comparison on validation-2k",
}
"""The stages and what they make."""
ORDER = (("value",), ("imitate",), ("ppo", "dqn"), ("models",))
"""Steps; the stages of a step run side by side."""
EXPECTED = "expected"
"""A text in a recipe that says how long it takes and how good its policies are."""
LAYOUT = Layout(
    begun="run.json",
    done="run.json",
    own=("run.json", "log.csv", *(f"{stage}.log" for stage in STAGES), *STAGES),
)
"""What the folder of a recipe holds: a folder for each stage."""


@dataclass(frozen=True)
class Options:
    """Train everything for a robot, from random weights: a value network, a student, PPO and DQN.

    Each stage is a command of its own, learns from those before it, and has a folder in the recipe's.
    """

    run: Run = field(default_factory=Run)
    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    ground: Ground = field(default_factory=Ground)
    budget: Annotated[str, tyro.conf.arg(metavar="quick|full|FILE.yaml")] = "quick"
    """quick: 15 minutes on two fast cores; full: an hour or more, as for the pretrained models; or a
    YAML file like those in agents/recipes/."""
    tasks: int = 500
    """Tasks of validation-2k for the final comparison."""

    @property
    def method(self) -> str:
        """What folders are named after."""
        return f"recipe-{Path(self.budget).stem}"


def train(options: Options, console: Console) -> Path:
    """Runs all stages, or those that an interrupted run has left.

    Returns:
        The folder with the models.
    """
    params = options.robot.params()
    options.engine.check()
    check_count("tasks", options.tasks)
    given, expected = _recipe(options.budget)
    asked = {
        "budget": options.budget,
        "stages": given,
        "tasks": options.tasks,
        "slip": options.ground.slip,
        "seed": options.run.seed,
        "params": dataclasses.asdict(params),
    }
    out = options.run.folder(f"{options.method}-{options.robot.name}")
    stages = {stage: _job(stage, given[stage], options, out) for stage in given}
    for job in stages.values():
        # all of them, before there is work to lose; the engine has been checked: it may be far away
        check(dataclasses.replace(job.options, engine=Engine()))
    with RunFolder(options.run, options.method, options.robot, asked, LAYOUT) as folder:
        if expected:
            console.print(expected, soft_wrap=True)
        rows = folder.rows("step")
        models = folder.path / "models"
        for step, level in enumerate(ORDER, 1):
            if step <= len(rows):
                continue
            began = time.monotonic()
            for stage in level:
                console.print(f"step {step} of {len(ORDER)}: {stage}: {STAGES[stage]}")
            if level == ("models",):
                made = {
                    "command": command(),
                    "budget": options.budget,
                    "seed": options.run.seed,
                    "slip": options.ground.slip,
                    "stages": given,
                }
                slip = options.ground.slip
                ship(folder.path, params, made, options.tasks, slip, options.engine)
            else:
                jobs = [stages[stage] for stage in level]
                if len(jobs) > 1:
                    side_by_side(jobs, options.engine, console)
                else:
                    jobs[0].train(console)
            minutes = (time.monotonic() - began) / 60.0
            rows.append({"step": str(step), "minutes": f"{minutes:.2f}"})
            folder.write_rows(rows)
            console.print(f"step {step} of {len(ORDER)}: {minutes:.1f} minutes")
        console.print(comparison(models))
        console.print(f"models: {models}", soft_wrap=True)
        return models


def check(options: Any) -> None:
    """Raises SnakeEnvError where a value among some options can't be used, or in a group of them."""
    if hasattr(options, "check"):
        options.check()
    for each in dataclasses.fields(options):
        value = getattr(options, each.name)
        if dataclasses.is_dataclass(value):
            check(value)


def _recipe(budget: str) -> tuple[dict[str, dict[str, Any]], str]:
    """The options of each stage, and what the file says one may expect.

    Raises:
        SnakeEnvError: There is no such file, or a stage is missing or unknown.
    """
    known = sorted(path.stem for path in RECIPES.glob("*.yaml"))
    if budget not in known and not budget.endswith((".yaml", ".yml")):
        raise UnknownNameError("budget", budget, [*known, "FILE.yaml"])
    given = read_yaml(RECIPES / f"{budget}.yaml" if budget in known else Path(budget))
    expected = given.pop(EXPECTED, "")
    if not isinstance(expected, str):
        raise InvalidInputError(EXPECTED, expected, "a string")
    stages = [stage for stage in STAGES if stage != "models"]
    for name in given:
        if name not in stages:
            raise UnknownNameError("stage in the recipe", name, stages)
    for stage in stages:
        if not isinstance(given.setdefault(stage, {}), dict):
            raise InvalidInputError(stage, given[stage], "a mapping of options to values")
    return given, expected


def _job(stage: str, given: Mapping[str, Any], options: Options, folder: Path) -> Job:
    """A stage as a command, with the paths of what it learns from."""
    value = str(folder / "value/value.safetensors")
    student = str(folder / "imitate/last.safetensors")
    paths: dict[str, dict[str, Any]] = {
        "ppo": {"init": student, "init_critic": value, "critic": value},
        "dqn": {"init": student, "critic": value},
    }
    own = {"out": str(folder / stage), "seed": options.run.seed, "resume": True}
    module: Any = importlib.import_module(f"train.{stage}")
    begun = module.Options(value=Path(value)) if stage == "imitate" else module.Options()
    chosen = replaced(begun, {**given, **paths.get(stage, {}), **own})
    shared = {"robot": options.robot, "engine": options.engine, "ground": options.ground}
    return Job(stage, dataclasses.replace(chosen, **shared), arguments())
