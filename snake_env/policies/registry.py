"""Policies: whatever chooses a mode at each t_k, behind one interface and one registry."""

from __future__ import annotations

import functools
import importlib.resources
import inspect
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.modes import mode_table
from snake_env.networks.model_file import read_model
from snake_env.params import SnakeParams
from snake_env.policies.base import CANDIDATES, Policy
from snake_env.policies.ends import ends
from snake_env.policies.lookahead import LookaheadPolicy
from snake_env.policies.network_policy import NetworkPolicy
from snake_env.policies.search import expand
from snake_env.policies.shield import ShieldedPolicy
from snake_env.policies.value import NetworkValue, ValueFunction, load_value, pretrained
from snake_env.sim.masks import instant_mask
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import predict
from snake_env.state import FloatArray, IntArray, SnakeState, StateBatch


class AnalyticPolicy:
    """The paper's optimiser (21); where no candidate is feasible, the one that holds out longest."""

    def __init__(self, params: SnakeParams, candidates: NDArray[np.bool_] | None = None) -> None:
        self.optimizer = AnalyticOptimizer(params, candidates)
        self.rollouts = 0

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode; nothing is remembered."""

    def select_mode(self, state: SnakeState) -> int:
        """The feasible mode of least J."""
        selection = self.optimizer.select(state)
        self.rollouts += len(selection.modes)
        return selection.last_resort


class FirstFeasiblePolicy:
    """The feasible mode of lowest index, predicting modes eight at a time."""

    def __init__(self, params: SnakeParams) -> None:
        self.params = params
        self.rollouts = 0

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode; nothing is remembered."""

    def select_mode(self, state: SnakeState) -> int:
        """The first feasible mode, or the first of all where there is none."""
        modes = mode_table(self.params.n_joints).valid(state.phase)
        for start in range(0, len(modes), CANDIDATES):
            block = modes[start : start + CANDIDATES]
            feasible = predict(state, block, self.params).feasible
            self.rollouts += len(block)
            if feasible.any():
                return int(block[np.argmax(feasible)])
        return int(modes[0])


class ValuePolicy:
    """The feasible mode whose successor needs the fewest intervals: predicts all modes, as (21) does.

    A network is not asked about modes that lead nowhere, as long as there are others.

    Args:
        params: The constants that it predicts with.
        value: Default: the shipped network ``value``, or what the planner is guided by.
    """

    def __init__(self, params: SnakeParams, value: ValueFunction | None = None) -> None:
        self.params = params
        self.rollouts = 0
        self._value = _quick_value(params) if value is None else value
        self._optimizer = AnalyticOptimizer(params)

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode; nothing is remembered."""

    def select_mode(self, state: SnakeState) -> int:
        """The feasible mode of best value; where none is feasible, the one that holds out longest."""
        modes, worth = self._choices(state)
        if len(modes) == 0:
            return self._optimizer.select(state).last_resort
        if len(modes) == 1:
            return int(modes[0])
        return int(modes[np.argmin(worth())])

    def _choices(self, state: SnakeState) -> tuple[IntArray, Callable[[], FloatArray]]:
        """The modes that can be executed, and who says what their ends are worth."""
        valid, value = self._optimizer.modes(state.phase), self._value
        self.rollouts += len(valid)
        if not isinstance(value, NetworkValue):
            tree = expand(StateBatch.stack([state]), self.params)
            return tree.mode, lambda: value(tree.states)
        found = ends(state, valid, self.params)  # a network needs no more than what is seen there
        kept = np.flatnonzero(found.executable & (found.turn >= _CREEPING))
        if len(kept) == 0:
            kept = np.flatnonzero(found.executable)
        seen, reached = found.observations.take(kept, axis=0), found.reached[kept]
        return valid[kept], lambda: value.of_observed(seen, reached)


_CREEPING = 0.01
"""Modes in which no joint turns as far as this in an interval lead nowhere [rad]: k_t goes to 0 as a
joint comes close to its limit, and a network that prefers one of them would do so again and again."""


def _quick_value(params: SnakeParams) -> ValueFunction:
    """The network that ships for single decisions."""
    model = pretrained("value", params.n_joints, params.head_contact)
    return load_value(params) if model is None else NetworkValue(model, params)


_POLICY_STREAMS = (0, 1)
"""Spawn key of policies' random numbers: no task's numbers are among them."""


class RandomPolicy:
    """A mode drawn uniformly from those that are stable at t_k: the floor of all learning."""

    def __init__(self, params: SnakeParams) -> None:
        self.params = params
        self.rollouts = 0
        self.reset()

    def reset(self, seed: int | None = None) -> None:
        """Begins an episode with random numbers of its own."""
        stream = np.random.SeedSequence(0 if seed is None else seed, spawn_key=_POLICY_STREAMS)
        self._rng = np.random.default_rng(stream)

    def select_mode(self, state: SnakeState) -> int:
        """A random mode of the instant mask."""
        return int(self._rng.choice(np.flatnonzero(instant_mask(state, self.params))))


@functools.lru_cache(maxsize=1)
def _reduced_candidates() -> NDArray[np.bool_]:
    """The candidates of ``analytic-14`` for 8 joints, shape (8, 99)."""
    resource = importlib.resources.files("snake_env") / "data" / "analytic_14.json"
    modes = json.loads(resource.read_text(encoding="utf-8"))["modes"]
    candidates = np.zeros((8, len(mode_table(8))), dtype=np.bool_)
    for phase, indices in modes.items():
        candidates[int(phase) - 1, indices] = True
    return candidates


def _analytic_14(params: SnakeParams) -> AnalyticPolicy:
    if params.n_joints != 8:
        raise InvalidInputError("n_joints", params.n_joints, "8 for the policy analytic-14")
    return AnalyticPolicy(params, _reduced_candidates())


def _learned(name: str) -> Callable[[SnakeParams], Policy]:
    """Makes the shipped policy of this name."""

    def policy(params: SnakeParams) -> Policy:
        model = pretrained(name, params.n_joints, params.head_contact)
        if model is None:
            robots = f"{params.n_joints} joints, head_contact {params.head_contact}"
            raise InvalidInputError("policy", name, f"one that ships for these robots ({robots})")
        return NetworkPolicy(params, model)

    return policy


POLICIES: dict[str, Callable[..., Policy]] = {
    "analytic": AnalyticPolicy,
    "analytic-14": _analytic_14,
    "first-feasible": FirstFeasiblePolicy,
    "random": RandomPolicy,
    "lookahead": LookaheadPolicy,
    "value": ValuePolicy,
    **{name: _learned(name) for name in ("imitate", "ppo", "dqn")},
}
"""Every policy by name; each entry makes one for given constants, and options where it has any."""
SHIELD = "+shield"


def load_policy(name: str | Path, params: SnakeParams | None = None) -> Policy:
    """A policy by name, or the policy of a model file.

    Args:
        name: ``analytic`` (21), ``analytic-14`` (21 over at most 14 candidates a phase, as the paper's
            Table II), ``first-feasible``, ``random``, ``lookahead`` (a planner), ``value`` (the
            feasible mode whose successor is worth most), ``imitate``, ``ppo``, ``dqn`` (learned, no
            roll-outs), or the path of a ``.safetensors`` file. ``+shield`` after it adds a
            :class:`snake_env.policies.shield.ShieldedPolicy`. Options follow a colon, as in
            ``lookahead:width=16,deadline_ms=inf``.
        params: The constants that it predicts with; default: the preset ``paper``.

    Raises:
        UnknownNameError: No such policy, or no such option.
        InvalidInputError: The policy does not exist for these constants, or not with this option; a
            damaged model file.
    """
    constants = params or SnakeParams()
    text = str(name)
    if text.endswith(SHIELD):
        return ShieldedPolicy(load_policy(text.removesuffix(SHIELD), constants), constants)
    if text.endswith(".safetensors"):
        model = read_model(Path(text))
        if model.kind == "policy":
            return NetworkPolicy(constants, model)
        return ValuePolicy(constants, NetworkValue(model, constants))
    base, colon, options = text.partition(":")
    if base not in POLICIES:
        raise UnknownNameError("policy", base, POLICIES)
    return POLICIES[base](constants, **_options(base, options) if colon else {})


def _options(name: str, text: str) -> dict[str, float]:
    """A policy's options from ``key=value,key=value``: numbers."""
    known = [
        key
        for key, parameter in inspect.signature(POLICIES[name]).parameters.items()
        if parameter.annotation in ("int", "float", "int | None")
    ]
    options: dict[str, float] = {}
    for assignment in text.split(","):
        key, _, value = assignment.partition("=")
        if key not in known:
            raise UnknownNameError(f"option of {name}", key, known)
        try:
            options[key] = int(value) if value.lstrip("-").isdigit() else float(value)
        except ValueError:
            raise InvalidInputError(f"{name}:{key}", value, "a number") from None
    return options
