"""``python -m train export RUN``: ship a run's best model with the package."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

import snake_env
from harness.command import in_one_line
from harness.files import write_atomically
from harness.folder import writable_folder
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Model, read_model, write_model
from train.records import read_about

_FILES = ("best.safetensors", "value.safetensors")
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.=,-]{0,59}")
_CARD = """# {name}

{what}

| | |
|---|---|
| robots | {n_joints} joints, {contact} |
| learned by | `{command}` |
| started from | {init} |
| seed | {seed} |
| network | {network} |
| source | revision {git} |
| validation | {validation} |

{limits} Results on the test tasks are in `docs/results.md`.
"""
_WHAT = {
    "policy": "Prefers modes: the policy takes the one it prefers among those that are stable at t_k, "
    "with no model roll-out. `+shield` checks the choice with a roll-out.",
    "value": "Says how many intervals a state still needs: such networks guide the policies `value` "
    "and `lookahead`, and the teacher of `imitate`.",
    "quick-value": "Says how many intervals a state still needs, when it is asked about one image "
    "of the state: such networks guide the policy `value`, whose decisions wait for them.",
}
_LIMITS = {
    "policy": "Without the shield a choice can break (22) or (23) within the interval. It knows random "
    "shapes within the joint limits, no slip, and these robots' constants only.",
    "value": "It is an estimate, learned on random shapes within the joint limits: plans are right all "
    "the same, as they are predicted by the model.",
}
_LIMITS["quick-value"] = _LIMITS["value"]


@dataclass(frozen=True)
class Options:
    """Write a run's best model, its manifest and its model card into the package."""

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of a finished run of train."""
    last: bool = False
    """Ship the last model, not the best: where the tasks of the validation are too few to tell a run's
    models apart."""
    name: str | None = None
    """Policy's name; default: the algorithm's, with -narrow and the joints where they differ."""
    into: Annotated[Path, tyro.conf.arg(metavar="DIR")] = (
        Path(snake_env.__file__).parent / "pretrained"
    )
    """Folder to write to."""
    overwrite: bool = False
    """Replace a model of this name in the folder."""


def train(options: Options, console: Console) -> None:
    """Writes ``NAME.safetensors`` and ``NAME.md``."""
    about = read_about(options.run, "run")
    wanted = ("last.safetensors",) if options.last else _FILES
    file = next((options.run / f for f in wanted if (options.run / f).is_file()), None)
    if file is None:
        expected = (
            "a run with a model: train writes last.safetensors at every checkpoint (--last ships it) "
            "and best.safetensors at every validation that is better than those before"
        )
        raise InvalidInputError("run", str(options.run), expected)
    model = read_model(file)
    params = about["config"]["params"]
    name = options.name
    if name is None:
        name = _name(about["algorithm"], params)
    made = {**model.made, "git": about["git"], "versions": about["versions"]}
    if not _NAME.fullmatch(name):
        expected = "a name of at most 60 letters, digits and -_.=,"
        raise InvalidInputError("name", name, expected)
    path = options.into / f"{name}.safetensors"
    try:
        card = _card(name, model, about)
    except (LookupError, TypeError, ValueError) as error:
        expected = f"an undamaged run ({in_one_line(error)})"
        raise InvalidInputError("run", str(options.run), expected) from None
    there = [each for each in (path, path.with_suffix(".md")) if each.exists()]
    if there and not options.overwrite:
        expected = "a new name (or --overwrite to replace the model)"
        raise InvalidInputError("name", str(there[0]), expected)
    writable_folder(options.into)
    write_model(path, dataclasses.replace(model, made=made))
    write_atomically(path.with_suffix(".md"), card)
    console.print(f"{path}", soft_wrap=True)


def _name(algorithm: str, params: dict[str, Any]) -> str:
    narrow = "" if params["head_contact"] else "-narrow"
    joints = "" if params["n_joints"] == 8 else f"-{params['n_joints']}"
    return f"{algorithm}{narrow}{joints}"


def _card(name: str, model: Model, about: dict[str, Any]) -> str:
    config, validation = about["config"], model.made.get("validation")
    figures = (
        f"raw {validation['raw_success']:.1%} in {validation['raw_time_s']:.1f} s, +critic "
        f"{validation['critic_success']:.1%} in {validation['critic_time_s']:.1f} s"
        f" on the first {config['validation_tasks']:,} of 2,000 tasks of `validation-2k`"
        if validation
        else "none"
    )
    return _CARD.format(
        name=name,
        what=_WHAT[model.kind],
        n_joints=model.params.n_joints,
        contact="link 0 gives a contact"
        if config["params"]["head_contact"]
        else "no contact of link 0",
        command=about["command"],
        init=_beginning(config),
        seed=config["seed"],
        network=" - ".join(map(str, model.network.sizes)),
        git=about["git"] or "unknown",
        validation=figures,
        limits=_LIMITS[model.kind],
    )


def _beginning(config: dict[str, Any]) -> str:
    """What a run began with."""
    begun: str = config.get("init") or "random weights"
    lessons = ", ".join(config.get("lessons") or ())
    return begun + (f" and the judgements of {lessons}" if lessons else "")
