"""What policies and users are given can't be written to: states, batches, trajectories, constants."""

import copy
import dataclasses
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest

from evaluate.protocol import run_episode
from snake_env import AnalyticOptimizer, InvalidInputError, SnakeState, StateBatch, load_policy
from snake_env.kernel.blocks import clock_of, constants_of
from snake_env.modes import mode_table
from snake_env.networks.symmetry import mirror
from snake_env.policies.baselines import reduced_candidates
from snake_env.policies.value import shipped
from snake_env.sb3 import SnakeVecEnv
from snake_env.sim.motion import trajectory
from snake_env.sim.simulation import advance
from tests.support.robots import PAPER, random_state, straight_state

COPIES: dict[str, Callable[[Any], Any]] = {
    "itself": lambda given: given,
    "pickled": lambda given: pickle.loads(pickle.dumps(given)),
    "deep copy": copy.deepcopy,
    "replaced": lambda given: dataclasses.replace(given),
}


def _arrays(given: Any) -> Iterator[np.ndarray]:
    for field in dataclasses.fields(given):
        value = getattr(given, field.name)
        if isinstance(value, np.ndarray):
            yield value


GIVEN: dict[str, Callable[[], Any]] = {
    "initial": straight_state,
    "made by hand": lambda: random_state(3),
    "advanced": lambda: advance(straight_state(), 0, PAPER)[0],
    "of a batch": lambda: StateBatch.stack([random_state(1), random_state(2)])[1],
    "batch": lambda: StateBatch.stack([random_state(1)]),
    "taken": lambda: StateBatch.stack([random_state(1)]).take([0, 0]),
    "put": lambda: StateBatch.stack([random_state(1)]).put(
        [0], StateBatch.stack([random_state(2)])
    ),
    "trajectory": lambda: trajectory(straight_state(), 0, PAPER),
    "of an env": lambda: _env().unwrapped.state,
}


def _env() -> gymnasium.Env[Any, Any]:
    env = gymnasium.make("snake_env:SnakeModeSelection-v0")
    env.reset(seed=0)
    return env


@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize("what", GIVEN)
def test_arrays__are_read_only(what: str, how: str) -> None:
    arrays = list(_arrays(COPIES[how](GIVEN[what]())))
    assert len(arrays) >= 3
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_state__keeps_a_copy_of_what_it_is_made_of() -> None:
    phi = np.full(8, 0.1)
    view = phi.view()
    view.setflags(write=False)  # what it shows can still change
    for given in (phi, view, phi.tolist()):
        state = random_state(0).replace(phi=given)
        phi[:] = 0.7
        assert state.phi.tolist() == [0.1] * 8
        phi[:] = 0.1
    assert phi.flags.writeable


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("phi", ["a"] * 8),
        ("phi", [[1.0], [2.0, 3.0]]),
        ("w", "abc"),
        ("target", object()),
        ("w", {}),
    ],
)
def test_state__of_other_things_than_numbers_is_refused(field: str, value: Any) -> None:
    with pytest.raises(
        InvalidInputError, match=rf"^state\.{field} = .*: expected an array of numb"
    ):
        random_state(0).replace(**{field: value})


def test_cached_constants__are_read_only() -> None:
    cached = [
        constants_of(PAPER),
        clock_of(PAPER),
        *mirror(8),
        reduced_candidates(),
        mode_table(8).lifted,
        mode_table(8).wheels,
        mode_table(8).n_lifted,
        mode_table(8).mask(1),
        AnalyticOptimizer(PAPER).modes(1),
        *shipped("ppo")[0].network.weights,
    ]
    for array in cached:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


class _Cheat:
    """Writes into the state that it is given."""

    rollouts = 0

    def __init__(self, cheat: Callable[[SnakeState], object]) -> None:
        self._cheat, self._honest = cheat, load_policy("analytic")

    def reset(self, seed: int | None = None) -> None: ...

    def select_mode(self, state: SnakeState) -> int:
        self._cheat(state)
        return self._honest.select_mode(state)


def _set(name: str, value: Any) -> Callable[[SnakeState], object]:
    return lambda state: getattr(state, name).__setitem__(slice(None), value)


@pytest.mark.parametrize(
    "cheat",
    [
        lambda state: state.phi.__setitem__(slice(None), state.target),
        _set("phi", 0.0),
        _set("w", 0.0),
        lambda state: np.copyto(state.target, state.phi),
        lambda state: state.phi.sort(),
        lambda state: setattr(state, "phase", 9),
    ],
)
def test_policy__that_writes_into_its_state_ends_in_an_error(
    cheat: Callable[[SnakeState], object],
) -> None:
    row = run_episode(_Cheat(cheat), random_state(5, phase=1), PAPER, 0)
    assert row["outcome"] == "error"
    assert row["intervals"] == 0


def test_observations_of_the_vector_env__are_the_callers_own() -> None:
    venv = SnakeVecEnv(4, mask_in_observation=True)
    seen = venv.reset()
    before = venv.action_masks()
    for array in seen.values():
        array[...] = 0
    assert np.array_equal(venv.action_masks(), before)
    seen, *_ = venv.step(before.argmax(axis=1))
    before = venv.action_masks()
    seen["action_mask"][...] = 0
    assert np.array_equal(venv.action_masks(), before)


def test_states__can_not_be_made_writable() -> None:
    given = np.zeros(8)
    given.setflags(write=False)
    states = [make() for name, make in GIVEN.items() if name not in ("batch", "taken", "put")]
    for state in [state for state in states if isinstance(state, SnakeState)]:
        for array in _arrays(state.replace(target=given)):
            assert not np.shares_memory(array, given)
            assert state.replace(elapsed=1.0).w is state.w  # what is frozen is shared
            with pytest.raises(ValueError, match="cannot set WRITEABLE"):
                array.setflags(write=True)
