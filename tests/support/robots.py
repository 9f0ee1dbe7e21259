"""Robots for the tests: constants, random states, the oracle's view of a state, episodes."""

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np
from hypothesis import strategies as st

from evaluate.protocol import Row
from snake_env.kernel.distance import d_min
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.motion import Trajectory, trajectory
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import advance, predict
from snake_env.sim.slip import NO_SLIP, Slip
from snake_env.sim.tasks import load_tasks, random_suite
from snake_env.state import FloatArray, SnakeState
from tests.support import oracle

PAPER = SnakeParams()
NARROW = SnakeParams.preset("narrow")
HARDWARE = SnakeParams.preset("hardware")
FIVE = SnakeParams(n_joints=5)
KNIFE_EDGE = 1e-9  # [m]: nearer to its edge than this, nobody can say whether the robot is stable

seeds = st.integers(0, 2**32 - 1)
shapes = st.lists(st.floats(-math.pi / 2, math.pi / 2), min_size=8, max_size=8).map(np.array)


def row_of(modes: Sequence[int], task: int = 0, slip: Slip = NO_SLIP) -> Row:
    """What a replay needs of an episode's row."""
    text = " ".join(map(str, modes))
    return {"task": task, "modes": text, "slip_m": slip[0], "slip_rad": slip[1]}


def mirrored(state: SnakeState, params: SnakeParams = PAPER) -> SnakeState:
    """The robot's mirror image."""
    x, y, heading = state.w - params.w_d
    return state.replace(
        w=np.array([x, -y, -heading]) + params.w_d,
        phi=-state.phi,
        target=-state.target,
        ref_start=-state.ref_start,
        last_turn=-state.last_turn,
    )


def straight_state(params: SnakeParams = PAPER) -> SnakeState:
    """Straight, with the straight shape as its target."""
    return SnakeState.initial(np.zeros(params.n_joints), np.zeros(params.n_joints), params)


def start_of(task: int, params: SnakeParams = PAPER, seed: int = 3) -> SnakeState:
    """Where a random task begins."""
    return random_suite(task + 1, seed, params).initial(task, params)


def random_shape(rng: np.random.Generator, params: SnakeParams) -> FloatArray:
    """A shape that does not collide with itself."""
    while True:
        phi = rng.uniform(-params.phi_limit, params.phi_limit, params.n_joints)
        if d_min(phi, params.l) >= 2 * params.l:
            return phi


def random_state(
    seed: int, params: SnakeParams = PAPER, phase: int | None = None, head_error: float = 0.02
) -> SnakeState:
    """A state in the middle of a phase, its head off by about ``head_error``."""
    rng = np.random.default_rng(seed)
    n = params.n_joints
    drawn = int(rng.integers(1, n + 1))
    phase = drawn if phase is None else phase
    phi, target = random_shape(rng, params), random_shape(rng, params)
    return SnakeState(
        w=np.array(params.w_d) + head_error * rng.normal(size=3),
        phi=phi,
        target=target,
        phase=phase,
        phase_time=float(rng.choice([0.0, 3.0, rng.uniform(0.0, 2.0)])),
        ref_start=float(phi[phase - 1] + 0.05 * rng.normal()),
        elapsed=float(rng.uniform(0.0, 100.0)),
    )


DEADLOCK = random_state(1, NARROW, 7)
"""No mode is feasible."""


def same_state(one: SnakeState, other: SnakeState) -> bool:
    """Whether two states are equal bit for bit, field by field."""
    return all(
        np.array_equal(getattr(one, field.name), getattr(other, field.name))
        for field in dataclasses.fields(SnakeState)
    )


def random_mode(seed: int, state: SnakeState) -> int:
    """A mode that the state's phase allows."""
    valid = mode_table(len(state.phi)).valid(state.phase)
    return int(np.random.default_rng((seed, 1)).choice(valid))


def feasible_case(seed: int, params: SnakeParams = PAPER) -> tuple[SnakeState, int]:
    """A random state and a random one of its feasible modes."""
    for attempt in range(100):
        state = random_state(seed + 1_000_003 * attempt, params)
        modes = mode_table(params.n_joints).valid(state.phase)
        feasible = modes[predict(state, modes, params).feasible]
        if len(feasible):
            return state, int(np.random.default_rng((seed, 2)).choice(feasible))
    raise AssertionError("no feasible case found")


def all_lifted(state: SnakeState, mode: int) -> oracle.Bools:
    """Every lifted wheel, the SCP's included, shape (n,)."""
    lifted = mode_table(len(state.phi)).lifted[mode].copy()
    lifted[state.phase - 1] = True
    return lifted


def oracle_constants(params: SnakeParams) -> oracle.Constants:
    """The oracle's constants with the values of ``params``."""
    names = set(oracle.Constants.__dataclass_fields__) - {"n"}
    return oracle.Constants(
        n=params.n_joints, **{name: getattr(params, name) for name in sorted(names)}
    )


def oracle_arguments(state: SnakeState, mode: int) -> dict[str, object]:
    """What the oracle's functions of a state call its fields."""
    return {
        "w": state.w,
        "phi": state.phi,
        "target": state.target,
        "phase": state.phase,
        "ref_start": state.ref_start,
        "phase_time": state.phase_time,
        "lifted": all_lifted(state, mode),
    }


def oracle_interval(state: SnakeState, mode: int, params: SnakeParams) -> oracle.Interval:
    """One interval as the oracle integrates it."""
    return oracle.interval(**oracle_arguments(state, mode), c=oracle_constants(params))


def stability_margin(phi: FloatArray, state: SnakeState, mode: int, params: SnakeParams) -> float:
    """The oracle's margin of (22) for a shape, under the wheels of a state's mode [m]."""
    lifted = all_lifted(state, mode)
    return oracle.stability_margin(np.zeros(3), phi, lifted, oracle_constants(params))


@functools.lru_cache
def sim_1_episode() -> tuple[list[SnakeState], list[int], list[Trajectory]]:
    """Simulation 1 under (21): states at each t_k, modes, and the motion between."""
    state = load_tasks("sim-1", PAPER).initial(0, PAPER)
    return run_episode(state, PAPER)


def run_episode(
    state: SnakeState, params: SnakeParams
) -> tuple[list[SnakeState], list[int], list[Trajectory]]:
    """An episode under (21), up to success, deadlock or the horizon."""
    optimizer = AnalyticOptimizer(params)
    states, modes, motions = [state], [], []
    while not state.done and len(modes) < params.horizon:
        mode = optimizer.select(state).mode
        if mode is None:
            break
        motions.append(trajectory(state, mode, params))
        state, _ = advance(state, mode, params)
        states.append(state)
        modes.append(mode)
    return states, modes, motions
