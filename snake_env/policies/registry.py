"""The registry of policies: whatever chooses a mode at each t_k, by name."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

from snake_env.errors import InvalidInputError, UnknownNameError, as_integer
from snake_env.networks.model_file import read_model
from snake_env.params import SnakeParams
from snake_env.policies.base import CANDIDATES, Policy
from snake_env.policies.baselines import (
    AnalyticPolicy,
    FirstFeasiblePolicy,
    RandomPolicy,
    analytic_14,
)
from snake_env.policies.lookahead import LookaheadPolicy
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.policies.one_step import CriticPolicy, ValuePolicy
from snake_env.policies.shield import ShieldedPolicy
from snake_env.policies.value import (
    ActionValue,
    NetworkValue,
    ValueFunction,
    pretrained,
    shipped,
)


def _learned(name: str) -> Callable[..., Policy]:
    """Makes the shipped policy of this name."""

    def policy(params: SnakeParams, transfer: bool = False) -> Policy:
        model = pretrained(params, name, transfer=transfer)
        if model is None:
            joints = sorted({each.params.n_joints for each in shipped(name)})
            expected = f"one of {joints}, for which {name} ships"
            raise InvalidInputError("n_joints", params.n_joints, expected)
        critic = pretrained(params, "value", transfer=transfer)  # shared, so shipped once
        return NetworkPolicy(params, dataclasses.replace(model, critic=critic), transfer)

    return policy


LEARNED = ("imitate", "ppo", "dqn")
POLICIES: dict[str, Callable[..., Policy]] = {
    "analytic": AnalyticPolicy,
    "analytic-14": analytic_14,
    "first-feasible": FirstFeasiblePolicy,
    "random": RandomPolicy,
    "lookahead": LookaheadPolicy,
    "value": ValuePolicy,
    **{name: _learned(name) for name in LEARNED},
}
"""Every policy by name; each entry makes one for given constants, and options where it has any."""
SHIELD, CRITIC = "+shield", "+critic"
MODEL_FILE = ".safetensors"


def load_policy(
    name: str | Path, params: SnakeParams | None = None, transfer: bool = False
) -> Policy:
    """A policy by name, or the policy of a model file.

    Args:
        name: ``analytic`` (21), ``analytic-14`` (21 over at most 14 candidates a phase, as the paper's
            Table II), ``first-feasible``, ``random``, ``lookahead`` (a planner), ``value`` (the
            feasible mode with the best next state), ``imitate``, ``ppo``, ``dqn`` (learned, no
            roll-outs), the path of a ``.safetensors`` file, or the folder of a run of ``python -m
            train``. ``+shield`` after it adds a :class:`snake_env.policies.shield.ShieldedPolicy`;
            ``+critic`` after a learned one a :class:`snake_env.policies.one_step.CriticPolicy`.
            Options follow a colon, as in ``lookahead:width=16,deadline_ms=inf``, ``ppo+critic:k=4`` or
            ``ppo+shield:transfer=1``.
        params: The constants that it predicts with; default: the preset ``paper``.
        transfer: Whether a network that was trained with other constants is accepted.

    Returns:
        The policy; call its ``reset`` before each episode.

    Raises:
        UnknownNameError: No such policy, or no such option.
        InvalidInputError: The policy does not exist for these constants, was trained with others, or
            not with this option; a damaged model file.
    """
    constants = params or SnakeParams()
    base, suffix, options = _parse(str(name))
    make: Callable[..., Policy]
    if base.endswith(MODEL_FILE):
        make, title = functools.partial(_of_file, Path(base)), "a model file"
    elif base in POLICIES:
        make, title = POLICIES[base], base
    elif base and Path(base).is_dir():
        make, title = functools.partial(_of_file, _of_run(Path(base))), "a model file"
    elif base.endswith(".zip"):
        expected = (
            "a model file (.safetensors): snake_env.sb3.write_sb3_model makes one of a model of "
            "Stable-Baselines3. Or give an adapter: --policy examples.sb3_model:SavedModel"
        )
        raise InvalidInputError("policy", base, expected)
    else:
        known = (*POLICIES, *(f"{learned}{CRITIC}" for learned in LEARNED))
        raise UnknownNameError("policy", base, (*known, "FILE.safetensors", "a run's folder"))
    known_options = [*_known_options(make), *(["k"] if suffix == CRITIC else [])]
    for key in options:
        if key not in known_options:
            raise UnknownNameError(f"option of {title}{suffix}", key, known_options)
    given: dict[str, Any] = {k: _number(f"{title}:{k}", text) for k, text in options.items()}
    if "transfer" in known_options:
        given["transfer"] = transfer = _truth(given.get("transfer", transfer))
    k = given.pop("k", CANDIDATES)
    policy = make(constants, **given)
    if suffix == SHIELD:
        return ShieldedPolicy(policy, constants)
    return _with_critic(policy, title, k, constants, transfer) if suffix == CRITIC else policy


def _with_critic(
    policy: Policy, title: str, k: float, params: SnakeParams, transfer: bool
) -> CriticPolicy:
    """A learned policy with the critic that its model holds, or with its own action values."""
    if not isinstance(policy, NetworkPolicy):
        raise InvalidInputError("policy", f"{title}{CRITIC}", "a learned policy before +critic")
    number = as_integer(k)
    if number is None or number < 1:
        raise InvalidInputError("k", k, "a positive integer")
    [model] = policy.models
    value: ValueFunction
    if model.critic is not None:
        value = NetworkValue(model.critic, params, transfer)
    elif model.action_values:
        value = ActionValue(model, params)
    else:
        expected = "a model file that holds a critic or action values"
        raise InvalidInputError("policy", f"{title}{CRITIC}", expected)
    return CriticPolicy(policy, value, params, number)


def _of_file(path: Path, params: SnakeParams, transfer: bool = False) -> Policy:
    """The policy of a model file."""
    model = read_model(path)
    if model.kind == "policy":
        return NetworkPolicy(params, model, transfer)
    return ValuePolicy(params, NetworkValue(model, params, transfer))


def _of_run(folder: Path) -> Path:
    """The model of a run of ``python -m train``.

    Raises:
        InvalidInputError: There is none, or a recipe's folder, which holds several.
    """
    names = ("best", "last", "value")
    found = [folder / f"{name}{MODEL_FILE}" for name in names]
    file = next((each for each in found if each.is_file()), None)
    if file is None:
        models = sorted(path.name for path in (folder / "models").glob(f"*{MODEL_FILE}"))
        expected = (
            f"one of its models, {', '.join(models)} in {folder / 'models'}"
            if models
            else "the folder of a run that has a model: best.safetensors or last.safetensors"
        )
        raise InvalidInputError("policy", str(folder), expected)
    return file


def _parse(text: str) -> tuple[str, str, dict[str, str]]:
    """A policy's base name, its suffix, and its options, which may stand before the suffix or after."""
    start = text.rfind(MODEL_FILE)  # a path may hold colons and pluses
    end = 0 if start < 0 else start + len(MODEL_FILE)
    head, tail = text[:end], text[end:]
    suffix = next((each for each in (SHIELD, CRITIC) if each in tail), "")
    plain, _, after = tail.partition(suffix) if suffix else (tail, "", "")
    if after and not after.startswith(":"):
        return text, "", {}
    name, colon, options = plain.partition(":")
    given = [options] * bool(colon) + [after[1:]] * bool(after)
    pairs = [pair.partition("=")[::2] for part in given for pair in part.split(",")]
    if len(dict(pairs)) < len(pairs):
        raise InvalidInputError("policy", text, "each option only once")
    return head + name, suffix, dict(pairs)


def _known_options(make: Callable[..., Policy]) -> list[str]:
    """The options of a policy that a number can be given for."""
    kinds = ("int", "float", "int | None", "bool")
    parameters = inspect.signature(make).parameters.values()
    return [each.name for each in parameters if each.annotation in kinds]


def _number(field: str, text: str) -> float:
    try:
        return int(text) if text.lstrip("-").isdigit() else float(text)
    except ValueError:
        raise InvalidInputError(field, text, "a number") from None


def _truth(value: float) -> bool:
    if value not in (0, 1):
        raise InvalidInputError("transfer", value, "0 or 1")
    return bool(value)
