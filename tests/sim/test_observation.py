"""The observation: against a NumPy transcription of its table, alone, in batches and in threads."""

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import snake_env
from snake_env import UnknownNameError
from snake_env.envs import SnakeModeSelectionEnv
from snake_env.equations.features import features
from snake_env.kernel.instant_mask import MAX_MODES
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.masks import action_masks
from snake_env.sim.observation import (
    observation_and_mask,
    observation_rows,
    observation_size,
    observe,
)
from snake_env.sim.simulation import instantly_stable
from snake_env.state import SnakeState, StateBatch
from tests.support import oracle
from tests.support.robots import NARROW, PAPER, oracle_constants, seeds

OTHER = SnakeParams(n_joints=11, l=0.05, track=0.2, phi_limit=1.2, cam_time=0.7, w_d=(0.1, 0, 1))
SIZES = (5, 8, 16)


def seen_state(seed: int, params: SnakeParams, phase: int | None = None) -> SnakeState:
    """A state that fills every row of the observation, some rows beyond their limits."""
    rng = np.random.default_rng(seed)
    n, reach = params.n_joints, 1.1 * params.phi_limit
    return SnakeState(
        w=np.array(params.w_d) + rng.choice([0.02, 0.2]) * rng.normal(size=3),
        phi=rng.uniform(-reach, reach, n),
        target=rng.uniform(-reach, reach, n),
        phase=int(rng.integers(1, n + 2)) if phase is None else phase,
        phase_time=float(rng.choice([0.0, rng.uniform(0.0, 2.0), 12.0, 33.0])),
        ref_start=float(rng.uniform(-reach, reach)),
        elapsed=float(rng.uniform(0.0, 100.0)),
        last_mode=int(rng.integers(-1, len(mode_table(n)))),
        last_turn=float(rng.normal(scale=0.4)),
    )


def transcription(state: SnakeState, params: SnakeParams) -> np.ndarray:
    """The table in the env's docstring, row by row."""
    n, limit, c = params.n_joints, params.phi_limit, oracle_constants(params)
    origin = np.zeros(3)  # the head's frame
    theta = oracle.headings(origin, state.phi)
    directions = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    centres = oracle.joints_and_centres(origin, state.phi, c)[1] / (2 * params.l)
    gravity = centres.mean(axis=0)
    scp = min(state.phase, n)
    error = (state.target - state.phi) / (2 * limit)
    last_lifted = mode_table(n).lifted[state.last_mode] if state.last_mode >= 0 else np.zeros(n)
    contacts = [centres[0]] if params.head_contact else []
    for k in range(1, n + 1):
        if k != scp:
            side = params.track / (4 * params.l) * np.array([-np.sin(theta[k]), np.cos(theta[k])])
            contacts += [centres[k] - side, centres[k] + side]
    margins = []
    for angle in 2 * np.pi * np.arange(8) / 8:
        towards = np.array([np.cos(angle), np.sin(angle)])
        margins.append(max((contact - gravity) @ towards for contact in contacts))
    rows = [
        state.phi / limit,
        state.target / limit,
        error,
        1 - abs(state.phi) / limit,
        np.arange(1, n + 2) == state.phase,
        [error[scp - 1]],
        [state.ref_start / limit],
        [state.phase_time / params.cam_time],
        [state.phase_time / 30],
        last_lifted,
        [state.last_turn / 0.5],
        (state.w - params.w_d) / [0.1, 0.1, 0.5],
        directions[1:].ravel(),
        centres[1:].ravel() / (n + 1),
        gravity / (n + 1),
        margins,
    ]
    assert [len(row) for row in rows] == [size for _, size in observation_rows(n)]
    return np.clip(np.concatenate(rows), -1, 1)


@given(seeds, st.sampled_from([PAPER, NARROW, OTHER, *(SnakeParams(n_joints=n) for n in SIZES)]))
def test_observation__is_its_table_transcribed(seed: int, params: SnakeParams) -> None:
    for phase in range(1, params.n_joints + 2):
        state = seen_state(seed + phase, params, phase)
        (seen,) = observe(StateBatch.stack([state]), params)
        assert seen.dtype == np.float32
        assert seen.tolist() == pytest.approx(transcription(state, params).tolist(), abs=1e-6)


def test_features__have_the_names_and_sizes_of_the_rows() -> None:
    for n in range(5, 17):
        some = [0.1] * n
        blocks = features(SnakeParams(n_joints=n), some, some, [0.0] * 3, 1.0, 0.0, 0.0, 0.0, some)
        assert [(name, len(values)) for name, values in blocks.items()] == observation_rows(n)


@pytest.mark.parametrize("params", [PAPER, NARROW, SnakeParams(n_joints=5)], ids="PN5")
def test_observation__has_the_bits_of_the_equations_on_floats(params: SnakeParams) -> None:
    for seed in range(30):
        state = seen_state(seed, params)
        lifted = mode_table(params.n_joints).lifted[state.last_mode] * float(state.last_mode >= 0)
        blocks = features(
            params,
            *(state.phi.tolist(), state.target.tolist(), state.w.tolist(), float(state.phase)),
            *(state.phase_time, state.ref_start, state.last_turn, lifted.tolist()),
        )
        values = [value for block in blocks.values() for value in block]
        expected = np.array(values, dtype=np.float32)
        assert observation_and_mask(state, params)[0].tobytes() == expected.tobytes()


@pytest.mark.parametrize("n_joints", SIZES)
def test_observation__of_a_batch_has_the_bits_of_those_one_by_one(n_joints: int) -> None:
    params = SnakeParams(n_joints=n_joints)
    batch = StateBatch.stack([seen_state(seed, params) for seed in range(37)])
    together = observe(batch, params)
    for size in (1, 2, 8, 9, 36):
        for start in range(0, 37, size):
            part = np.arange(start, min(start + size, 37))
            assert observe(batch.take(part), params).tobytes() == together[part].tobytes()
    backwards = observe(batch.take(np.arange(37)[::-1]), params)
    assert backwards[::-1].tobytes() == together.tobytes()


@pytest.mark.parametrize("n_joints", SIZES)
def test_observation__of_no_states_is_empty(n_joints: int) -> None:
    params = SnakeParams(n_joints=n_joints)
    none = StateBatch.stack([seen_state(0, params)]).take([])
    assert observe(none, params).shape == (0, observation_size(n_joints))
    assert observe(none, params).dtype == np.float32


def _same_as_in_a_batch(state: SnakeState, params: SnakeParams) -> None:
    batch = StateBatch.stack([state])
    observation, mask = observation_and_mask(state, params)
    assert (observation.dtype, mask.dtype) == (np.float32, np.bool_)
    assert observation.tobytes() == observe(batch, params)[0].tobytes()
    assert mask.tolist() == action_masks(batch, params, "instant")[0].tolist()


@pytest.mark.parametrize("params", [PAPER, NARROW, *(SnakeParams(n_joints=n) for n in (5, 9))])
def test_observe_one__is_observation_and_instant_mask(params: SnakeParams) -> None:
    for seed in range(20):
        for phase in range(1, params.n_joints + 2):
            _same_as_in_a_batch(seen_state(seed, params, phase), params)


def test_observe_one__of_a_long_robot_tests_its_modes_one_by_one() -> None:
    params = SnakeParams(n_joints=16)
    assert len(mode_table(16)) > MAX_MODES
    for phase in (9, 14, 16, 17):
        _same_as_in_a_batch(seen_state(phase, params, phase), params)


def test_observe_one__falls_back_to_the_phases_modes_where_none_is_stable() -> None:
    params = NARROW.replace(track=1e-3)  # nearly straight robots tip over in every mode
    table, fallen = mode_table(8), 0
    for seed in range(400):
        state = seen_state(seed, params, 1 + seed % 8)
        state = state.replace(phi=0.2 * state.phi)
        allowed = table.mask(state.phase)
        copies = StateBatch.stack([state]).take([0] * allowed.sum())
        stable = instantly_stable(copies, np.flatnonzero(allowed), params)
        mask = observation_and_mask(state, params)[1]
        assert mask[allowed].tolist() == (stable if stable.any() else ~stable).tolist()
        assert not mask[~allowed].any()
        fallen += not stable.any()
    assert 3 < fallen < 100


def test_observe_one__gives_fresh_arrays() -> None:
    states = [seen_state(seed, PAPER, 2) for seed in (1, 2)]
    first = observation_and_mask(states[0], PAPER)
    kept = [array.copy() for array in first]
    observation_and_mask(states[1], PAPER)
    assert all(np.array_equal(*pair) for pair in zip(first, kept, strict=True))
    for array in first:
        array[:] = 0
    again = observation_and_mask(states[0], PAPER)
    assert all(np.array_equal(*pair) for pair in zip(again, kept, strict=True))


def test_observe_one__is_right_in_threads_at_once() -> None:
    states = [seen_state(seed, PAPER) for seed in range(40)]
    params = [PAPER, PAPER.replace(track=0.2), PAPER.replace(phi_limit=1.5)]
    expected = {
        (k, j): [array.tobytes() for array in observation_and_mask(state, p)]
        for k, state in enumerate(states)
        for j, p in enumerate(params)
    }
    wrong: list[tuple[int, int]] = []
    start = threading.Barrier(4)

    def work(seed: int) -> None:
        start.wait()
        rng = np.random.default_rng(seed)
        for k, j in zip(rng.integers(40, size=2000), rng.integers(3, size=2000), strict=True):
            seen = observation_and_mask(states[k], params[j])
            if [array.tobytes() for array in seen] != expected[k, j]:
                wrong.append((int(k), int(j)))

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


@pytest.mark.parametrize("params", [PAPER, NARROW, OTHER])
def test_public_observe_and_mask__are_those_of_the_env(params: SnakeParams) -> None:
    changes = {name: pair[0] for name, pair in params.differences(PAPER).items()}
    env = SnakeModeSelectionEnv(**changes)
    for seed in range(5):
        seen, info = env.reset(seed=seed)
        assert np.array_equal(snake_env.observe(env.state, params), seen)
        assert np.array_equal(snake_env.observe(StateBatch.stack([env.state]), params), [seen])
        assert np.array_equal(snake_env.action_mask(env.state, params), info["action_mask"])
        for level in ("structural", "instant", "lookahead"):
            expected = action_masks(StateBatch.stack([env.state]), params, level)[0]
            assert np.array_equal(snake_env.action_mask(env.state, params, level), expected)
    with pytest.raises(UnknownNameError, match="did you mean 'instant'"):
        snake_env.action_mask(env.state, params, "instnt")
