"""``python -m train export RUN``: ship the models of a recipe, or of a run, with the package."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

import snake_env
from harness.console import in_one_line
from harness.folder import writable_folder
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Model, read_model, write_model
from snake_env.system.files import write_atomically
from train.models import SOURCES, TABLE
from train.records import read_about
from train.validation import SUITE, in_words

_FILES = ("best.safetensors", "value.safetensors")
PACKAGE = Path(snake_env.__file__).parent / "pretrained"
"""Where shipped models are."""
SHIPPED = ("ppo", "dqn", "value")
"""What of a recipe ships for every robot; ``paper`` has all. A wheel has little room."""
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.=,-]{0,59}")
_CARD = """# {name}

{what}

| | |
|---|---|
| robot | {robot} |
| learned by | `{command}` |
| started from | {init} |
| seed | {seed} |
| network | {network} |
| critic | {critic} |
| source | revision {git} |
| validation | {validation} |

{limits} Results on the test tasks are in `docs/results.md`.
"""
_WHAT = {
    "policy": "Policy network. It chooses the mode with the highest logit among those that are stable "
    "at t_k, without roll-outs. `+shield` checks the choice with a roll-out; `+critic` simulates the "
    "eight modes with the highest logits and executes the one whose end its critic rates best.",
    "value": "Value network. It estimates how many intervals are left to the target. It ranks states "
    "for the policies `value`, `+critic` and `lookahead`, and for the teacher of `imitate`.",
}
_LIMITS = {
    "policy": "Without `+shield` or `+critic` a choice can break (22) or (23) within the interval. The "
    "network was trained on random shapes within the joint limits, {ground}, for this robot only.",
    "value": "The network was trained on random shapes within the joint limits, for this robot only.",
}


@dataclass(frozen=True)
class Options:
    """Write the models of a recipe, or the best one of a run, into the package, with their cards."""

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of a finished recipe or run of train."""
    name: str | None = None
    """Policy's name, for a single run; default: the algorithm's. The robot's name follows it, unless
    that is paper."""
    into: Annotated[Path, tyro.conf.arg(metavar="DIR")] = PACKAGE
    """Folder to write to. The package's own takes models of committed revisions only."""
    overwrite: bool = False
    """Replace models of these names in the folder."""


def train(options: Options, console: Console) -> None:
    """Writes ``NAME.safetensors`` and ``NAME.md`` for each model."""
    about = read_about(options.run, "run")
    git, ships = about["git"], options.into.resolve() == PACKAGE.resolve()
    if ships and (git is None or git.endswith("+")):
        expected = "a run of a committed revision: its source had been changed (or --into DIR)"
        raise InvalidInputError("git", git, expected)
    written = {}
    for name, file in _models(options, about, ships).items():
        if not _NAME.fullmatch(name):
            expected = "a name of at most 60 letters, digits and -_.=,"
            raise InvalidInputError("name", name, expected)
        model = read_model(file)
        critic = _critic(model)
        if ships and (options.run / "models").is_dir() and model.critic:
            beside = name.replace(name.partition("-")[0], "value", 1)
            model, critic = dataclasses.replace(model, critic=None), f"the model `{beside}`"
        made = {**model.made, "git": git, "versions": about["versions"]}
        path = options.into / f"{name}.safetensors"
        try:
            card = _card(name, model, about, critic)
        except (LookupError, TypeError, ValueError) as error:
            expected = f"an undamaged run ({in_one_line(error)})"
            raise InvalidInputError("run", str(options.run), expected) from None
        there = [each for each in (path, path.with_suffix(".md")) if each.exists()]
        if there and not options.overwrite:
            expected = "a new name (or --overwrite to replace the model)"
            raise InvalidInputError("name", str(there[0]), expected)
        written[path] = dataclasses.replace(model, made=made), card
    writable_folder(options.into)
    for path, (model, card) in written.items():
        write_model(path, model)
        write_atomically(path.with_suffix(".md"), card)
        console.print(f"{path}", soft_wrap=True)


def _models(options: Options, about: dict[str, Any], ships: bool) -> dict[str, Path]:
    """The models of a recipe, or of a run, by the names that they get."""
    robot = about["robot"]
    suffix = "" if robot == "paper" else f"-{robot}"
    models = options.run / "models"
    if models.is_dir():
        if options.name is not None:
            raise InvalidInputError(
                "name", options.name, "no --name: a recipe's models have fixed names"
            )
        if not (models / TABLE).is_file():
            expected = "a finished recipe: --resume continues it"
            raise InvalidInputError("run", str(options.run), expected)
        names = SHIPPED if ships and robot != "paper" else SOURCES
        return {f"{name}{suffix}": models / f"{name}.safetensors" for name in names}
    file = next((options.run / f for f in _FILES if (options.run / f).is_file()), None)
    if file is None:
        expected = (
            "a finished run: train writes best.safetensors at every validation that is better"
        )
        raise InvalidInputError("run", str(options.run), expected)
    return {f"{about['algorithm']}{suffix}" if options.name is None else options.name: file}


def _critic(model: Model) -> str:
    return "none" if model.critic is None else " - ".join(map(str, model.critic.network.sizes))


def _card(name: str, model: Model, about: dict[str, Any], critic: str) -> str:
    made, params = model.made, model.params
    robot = f"`{about['robot']}`: {params.n_joints} joints, " + (
        "link 0 gives a contact" if params.head_contact else "no contact of link 0"
    )
    return _CARD.format(
        name=name,
        what=_WHAT[model.kind],
        robot=robot,
        command=made["command"],
        init=_beginning(made),
        seed=about["config"]["seed"],
        network=" - ".join(map(str, model.network.sizes)),
        critic=critic,
        git=about["git"] or "unknown",
        validation=_validation(made),
        limits=_LIMITS[model.kind].format(ground=_ground(*about["config"]["slip"])),
    )


def _beginning(made: Mapping[str, Any]) -> str:
    """What a run began with, or a recipe's stages."""
    if "stages" in made:
        return f"random weights, by the stages {', '.join(made['stages'])}"
    begun = made["config"].get("init")
    return f"the model with SHA-256 {begun[:16]}..." if begun else "random weights"


def _ground(metres: float, radians: float) -> str:
    if not (metres or radians):
        return "without slip"
    return f"with slip of up to {2000.0 * metres:g} mm and {2.0 * radians:g} rad per interval"


def _validation(made: Mapping[str, Any]) -> str:
    """What was found on tasks of the validation suite."""
    found = made.get("validation")
    if not found:
        return "none"
    if "stages" in made:
        rows = (
            f"`{name}` {row['success']}/{row['n']}"
            + ("" if row["time_s"] is None else f" in {row['time_s']:.1f} s")
            for name, row in found.items()
        )
        return ", ".join(rows) + f" on tasks of `{SUITE}`"
    count = made["config"]["validation_tasks"]
    return f"{in_words(found)} on the first {count:,} of 2,000 tasks of `{SUITE}`"
