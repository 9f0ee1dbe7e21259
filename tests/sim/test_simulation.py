"""One interval: every lane on its own, bit for bit; trajectories, phases, violations, symmetries."""

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from snake_env import set_num_threads
from snake_env.errors import InvalidInputError
from snake_env.kernel import blocks as blocks_module
from snake_env.kernel.distance import d_min
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim import lanes as lanes_module
from snake_env.sim.motion import trajectories, trajectory
from snake_env.sim.simulation import (
    Prediction,
    advance,
    advance_batch,
    cost,
    joint_input,
    predict,
    predict_batch,
)
from snake_env.state import SnakeState, StateBatch
from tests.support.interpreter import fma
from tests.support.robots import (
    KNIFE_EDGE,
    NARROW,
    PAPER,
    feasible_case,
    mirrored,
    random_mode,
    random_state,
    same_state,
    seeds,
    stability_margin,
    straight_state,
)

ALL = np.arange(99)


def _bits(prediction: Prediction) -> list[bytes]:
    """Each lane's fields as bytes."""
    fields = [getattr(prediction, field.name) for field in dataclasses.fields(Prediction)]
    return [b"".join(field[lane].tobytes() for field in fields) for lane in range(len(prediction))]


def _violating(name: str, params: SnakeParams = PAPER) -> tuple[SnakeState, int, Prediction]:
    """A state and a mode that breaks (22) or (23) after a while."""
    for seed in range(500):
        state = random_state(seed, params)
        modes = mode_table(8).valid(state.phase)
        prediction = predict(state, modes, params)
        late = (prediction.violation == name) & (prediction.duration > 0.5)
        if late.any():
            mode = int(modes[np.argmax(late)])
            return state, mode, predict(state, [mode], params)
    raise AssertionError(f"no mode violates {name}")


@pytest.fixture
def threads() -> Iterator[None]:
    """Puts the number of threads back."""
    yield
    set_num_threads(1)


@pytest.fixture(scope="module")
def mixed() -> tuple[StateBatch, np.ndarray, list[bytes]]:
    """90 states of all phases with a mode each, and what each does alone."""
    states = [random_state(seed) for seed in range(90)]
    modes = [random_mode(seed, state) for seed, state in enumerate(states)]
    alone = [_bits(predict(*case, PAPER))[0] for case in zip(states, ([m] for m in modes))]  # noqa: B905
    return StateBatch.stack(states), np.array(modes), alone


def test_lane__does_not_depend_on_the_modes_beside_it() -> None:
    state = random_state(3, phase=1)
    together = _bits(predict(state, ALL, PAPER))
    assert len(set(together)) > 50
    assert together == [_bits(predict(state, [mode], PAPER))[0] for mode in ALL]


def test_lane__does_not_depend_on_the_states_beside_it(mixed) -> None:  # type: ignore[no-untyped-def]
    states, modes, alone = mixed
    assert _bits(predict_batch(states, modes, PAPER)) == alone
    rng = np.random.default_rng(0)
    for size in (90, 17, 8, 3):
        order = rng.permutation(90)[:size]
        bits = _bits(predict_batch(states.take(order), modes[order], PAPER))
        assert bits == [alone[k] for k in order]


def test_mode__may_be_repeated_in_any_order() -> None:
    state = random_state(3, phase=1)
    first, second, again = _bits(predict(state, [30, 7, 30], PAPER))
    assert first == again == _bits(predict(state, [30], PAPER))[0]
    assert second == _bits(predict(state, [7], PAPER))[0] != first


@pytest.mark.parametrize("count", [1, 2, 3, 50])
@pytest.mark.usefixtures("threads")
def test_lane__does_not_depend_on_threads(mixed, count: int) -> None:  # type: ignore[no-untyped-def]
    states, modes, alone = mixed
    set_num_threads(count)
    assert _bits(predict_batch(states, modes, PAPER)) == alone
    assert _bits(predict_batch(states.take([5]), modes[[5]], PAPER)) == [alone[5]]


@pytest.mark.parametrize("lanes", [1, 2, 4, 8])
def test_lane__does_not_depend_on_the_width_of_blocks(  # type: ignore[no-untyped-def]
    mixed, lanes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    states, modes, alone = mixed
    monkeypatch.setattr(lanes_module, "block_width", lambda count: lanes)
    assert _bits(predict_batch(states, modes, PAPER)) == alone


@pytest.mark.parametrize("widths", [(4,), (4, 8), (2, 4)])
def test_lane__does_not_depend_on_how_many_share_the_call(  # type: ignore[no-untyped-def]
    mixed, widths: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blocks_module, "block_widths", lambda: widths)
    states, modes, alone = mixed
    for count in range(1, 10):
        some = np.arange(count)
        assert _bits(predict_batch(states.take(some), modes[some], PAPER)) == alone[:count]


@pytest.mark.parametrize(
    ("bits", "expected"), [(128, [4, 4, 4, 4, 4]), (256, [4, 4, 4, 4, 4]), (512, [4, 4, 8, 8, 8])]
)
def test_block_width__few_lanes_never_pay_for_idle_ones_where_a_narrower_block_is_faster(
    bits: int, expected: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blocks_module, "vector_bits", lambda: bits)
    monkeypatch.setattr(blocks_module, "block_widths", blocks_module.block_widths.__wrapped__)
    assert [blocks_module.block_width(count) for count in (1, 4, 5, 99)] == expected[:4]
    assert blocks_module.block_width() == expected[4]


@pytest.mark.parametrize("count", [0, -1, 1.0, True, None, "2"])
def test_set_num_threads__refuses_what_is_no_count(count: object) -> None:
    with pytest.raises(InvalidInputError, match=r"^count = .*positive number of threads"):
        set_num_threads(count)  # type: ignore[arg-type]


@pytest.mark.parametrize("modes", [[], [0]])
@pytest.mark.parametrize(
    "wrong", [{"phase": 10}, {"phase": 1.5}, {"phase": "1"}, {"last_mode": 99}, {"elapsed": 1e7}]
)
def test_predict__checks_a_state_whatever_modes_are_asked_about(
    wrong: dict[str, object], modes: list[int]
) -> None:
    (field,) = wrong
    with pytest.raises(InvalidInputError, match=rf"^state\.{field} = "):
        predict(straight_state().replace(**wrong), modes, PAPER)


def test_predict__of_numbers_of_numpy_is_that_of_pythons() -> None:
    state, modes = random_state(4, phase=2), mode_table(8).valid(2)
    numbers = {"phase": np.int64(2), "elapsed": np.float32(state.elapsed), "phase_time": 0}
    other = state.replace(**numbers)
    assert _bits(predict(other, modes, PAPER)) == _bits(
        predict(state.replace(phase_time=0.0), modes, PAPER)
    )


@pytest.mark.parametrize("phase", [1, 8, 9])
def test_predict__of_no_modes_is_empty(phase: int) -> None:
    prediction = predict(straight_state().replace(phase=phase), [], PAPER)
    assert len(prediction) == 0
    assert prediction.phi.shape == (0, 8)


def test_predict__changes_nothing_it_was_given() -> None:
    state, modes = random_state(0, phase=1), ALL.copy()
    before = StateBatch.stack([state])[0]
    predict(state, modes, PAPER)
    assert same_state(state, before)
    assert np.array_equal(modes, ALL)


@given(seeds)
@settings(max_examples=15)
def test_joint_input__is_the_kernels_to_the_bit(seed: int) -> None:
    state, mode = feasible_case(seed)
    motion = trajectory(state, mode, PAPER)
    for step in (0, 1, 40, 75, 111, 149):
        there = state.replace(phi=motion.phi[step], w=motion.w[step])
        u = joint_input(there, mode, float(motion.t[step]), PAPER)
        assert u.tobytes() == motion.u[step].tobytes()


@given(seeds)
@settings(max_examples=15)
def test_trajectory__is_eulers_and_ends_where_the_prediction_ends(seed: int) -> None:
    state = random_state(seed)
    mode = random_mode(seed, state)
    motion, prediction = trajectory(state, mode, PAPER), predict(state, [mode], PAPER)
    assert np.array_equal(motion.phi[0], state.phi)
    assert np.array_equal(motion.w[0], state.w)
    for before, u, after in zip(motion.phi, motion.u, motion.phi[1:], strict=False):
        assert after.tolist() == [fma(PAPER.dt, *pair) for pair in zip(u, before, strict=True)]
    assert motion.phi[-1].tobytes() == prediction.phi[0].tobytes()
    assert motion.w[-1].tobytes() == prediction.w[0].tobytes()
    assert motion.t[-1] == pytest.approx(prediction.duration[0], abs=1e-12)
    assert len(motion.t) == len(motion.phi) == len(motion.w) == len(motion.u) + 1
    assert prediction.max_abs_phi[0] == np.abs(motion.phi).max()


def test_prediction__sums_up_its_trajectory() -> None:
    state, mode = feasible_case(11)
    motion, prediction = trajectory(state, mode, PAPER), predict(state, [mode], PAPER)
    there = [state.replace(phi=phi) for phi in motion.phi]
    integral = sum(cost(s, mode, PAPER)[0] * PAPER.dt for s in there[:-1])
    turned = abs(motion.phi[-1] - state.phi)[state.phase - 1]
    assert prediction.cost[0] == pytest.approx(integral, rel=1e-13)
    assert prediction.j[0] == pytest.approx(integral + PAPER.a_scp / turned, rel=1e-13)
    assert prediction.d_min[0] == min(d_min(s.phi, PAPER.l) for s in there)
    assert prediction.duration[0] == PAPER.delta_t
    assert (prediction.feasible[0], prediction.violation[0]) == (True, "")


def test_trajectories__of_many_states_are_those_of_each() -> None:
    states = [random_state(seed) for seed in range(6)]
    modes = [random_mode(seed, state) for seed, state in enumerate(states)]
    for motion, state, mode in zip(
        trajectories(StateBatch.stack(states), modes, PAPER), states, modes, strict=True
    ):
        alone = trajectory(state, mode, PAPER)
        assert motion.u.tobytes() == alone.u.tobytes()
        assert motion.phi.tobytes() == alone.phi.tobytes()


def test_standing_still__scores_by_the_floor_of_the_rotation() -> None:
    prediction = predict(straight_state(), [0], PAPER)
    v = PAPER.a_s / PAPER.det_floor
    assert prediction.j[0] == pytest.approx(3.0 * v + 1e-4 / 1e-12, rel=1e-12)
    assert not prediction.phi.any()


def test_advance__shifts_one_phase_at_a_time() -> None:
    state = straight_state()  # every joint is at its target already
    for phase in range(1, 9):
        assert state.phase == phase
        state, _ = advance(state, 0, PAPER)
        assert (state.phase_time, state.elapsed) == (0.0, 3.0 * phase)
    assert state.done


def test_advance__starts_the_next_cam_where_that_joint_is() -> None:
    state = random_state(1, phase=3)
    state = state.replace(target=np.where(np.arange(8) == 2, state.phi, state.target))
    state = state.replace(ref_start=float(state.phi[2]))
    mode = int(np.flatnonzero(predict(state, mode_table(8).valid(3), PAPER).feasible)[0])
    mode = int(mode_table(8).valid(3)[mode])
    after, prediction = advance(state, mode, PAPER)
    assert (after.phase, after.phase_time) == (4, 0.0)
    assert after.ref_start == after.phi[3] == prediction.phi[0, 3] != state.phi[3]
    assert after.elapsed == state.elapsed + 3.0


def test_advance__stays_in_the_phase_until_18_holds_strictly() -> None:
    state, mode = feasible_case(2)
    scp = state.phase - 1
    error = float(abs(predict(state, [mode], PAPER).phi[0, scp] - state.target[scp]))
    assert error > 0.0
    after, _ = advance(state, mode, PAPER.replace(epsilon_p=error))
    assert (after.phase, after.ref_start) == (state.phase, state.ref_start)
    assert after.phase_time == state.phase_time + 3.0
    assert after.elapsed == state.elapsed + 3.0
    after, _ = advance(state, mode, PAPER.replace(epsilon_p=math.nextafter(error, 1.0)))
    assert after.phase == state.phase + 1


def test_advance_batch__is_advance_of_each() -> None:
    states = [random_state(seed) for seed in range(12)]
    modes = [random_mode(seed, state) for seed, state in enumerate(states)]
    after, prediction = advance_batch(StateBatch.stack(states), modes, PAPER)
    for k, (state, mode) in enumerate(zip(states, modes, strict=True)):
        alone, alone_prediction = advance(state, mode, PAPER)
        assert _bits(alone_prediction) == [_bits(prediction)[k]]
        assert same_state(after[k], alone)


@pytest.mark.parametrize("name", ["stability", "joint_limit"])
def test_violation__ends_the_interval_where_it_occurs(name: str) -> None:
    state, mode, prediction = _violating(name)
    assert (prediction.violation[0], prediction.feasible[0]) == (name, False)
    assert prediction.j[0] == math.inf
    motion = trajectory(state, mode, PAPER)
    largest = np.abs(motion.phi).max(axis=1)
    assert largest[:-1].max() <= PAPER.phi_limit + PAPER.limit_tolerance
    assert (largest[-1] > PAPER.phi_limit + PAPER.limit_tolerance) == (name == "joint_limit")
    margins = [stability_margin(phi, state, mode, PAPER) for phi in motion.phi]
    assert min(margins[:-1]) > 0
    assert name == "joint_limit" or margins[-1] < 0
    after, _ = advance(state, mode, PAPER.replace(epsilon_p=10.0))
    assert after.phase == state.phase
    assert np.array_equal(after.phi, motion.phi[-1])
    assert after.elapsed - state.elapsed == pytest.approx(len(motion.u) * PAPER.dt, abs=1e-9)


@pytest.mark.parametrize(("excess", "violation"), [(0.9e-6, ""), (1.1e-6, "joint_limit")])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_joint_limit__tolerates_rounding_only(excess: float, violation: str, sign: float) -> None:
    phi = np.array([0.0] * 7 + [sign * (math.pi / 2 + excess)])
    resting = straight_state().replace(phi=phi, target=phi, ref_start=float(phi[7]), phase=8)
    prediction = predict(resting, [0], PAPER)
    assert prediction.violation[0] == violation
    assert prediction.duration[0] == pytest.approx(PAPER.dt if violation else PAPER.delta_t)
    assert np.array_equal(prediction.phi[0], phi)


def test_unstable_start__moves_nothing() -> None:
    state, mode = straight_state(NARROW), mode_table(8).index([2, 3, 4])
    prediction = predict(state.replace(target=state.target + 0.1), [mode], NARROW)
    assert (prediction.violation[0], prediction.duration[0]) == ("stability", 0.0)
    assert prediction.j[0] == math.inf
    assert np.array_equal(prediction.phi[0], state.phi)
    assert trajectory(state, mode, NARROW).u.shape == (0, 8)


def _knife_edge(state: SnakeState, mode: int, end: np.ndarray) -> bool:
    margins = [stability_margin(phi, state, mode, PAPER) for phi in (state.phi, end)]
    return min(map(abs, margins)) < KNIFE_EDGE


@given(seeds)
def test_mirrored_robot__moves_as_the_mirror_image(seed: int) -> None:
    state = random_state(seed)
    mode = random_mode(seed, state)
    a, b = predict(state, [mode], PAPER), predict(mirrored(state), [mode], PAPER)
    assume(not _knife_edge(state, mode, a.phi[0]))
    assert a.violation[0] == b.violation[0]
    assert np.allclose(b.phi, -a.phi, rtol=0, atol=1e-9)
    assert np.allclose(b.w, [[a.w[0, 0], -a.w[0, 1], 2 * math.pi - a.w[0, 2]]], rtol=0, atol=1e-9)
    if a.feasible[0]:
        assert b.j[0] == pytest.approx(a.j[0], rel=1e-7)


@given(seeds, st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3))
def test_moved_world__changes_nothing_but_the_heads_place(
    seed: int, dx: float, dy: float, turn: float
) -> None:
    c, s = math.cos(turn), math.sin(turn)

    def move(w: np.ndarray) -> np.ndarray:
        x, y, heading = w
        return np.array([c * x - s * y + dx, s * x + c * y + dy, heading + turn])

    state = random_state(seed)
    mode = random_mode(seed, state)
    params = PAPER.replace(w_d=move(np.array(PAPER.w_d)))
    a, b = predict(state, [mode], PAPER), predict(state.replace(w=move(state.w)), [mode], params)
    assume(not _knife_edge(state, mode, a.phi[0]))
    assert a.violation[0] == b.violation[0]
    assert np.allclose(b.phi, a.phi, rtol=0, atol=1e-9)
    assert np.allclose(b.w[0], move(a.w[0]), rtol=0, atol=1e-9)
    if a.feasible[0]:
        assert b.j[0] == pytest.approx(a.j[0], rel=1e-7)
