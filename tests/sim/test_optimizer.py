"""(21): the cheapest feasible mode, why others are refused, and whole episodes under it."""

import numpy as np
import pytest

from snake_env.errors import InvalidInputError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.sim.optimizer import AnalyticOptimizer
from snake_env.sim.simulation import advance, predict
from snake_env.state import SnakeState
from tests.support.robots import (
    DEADLOCK,
    NARROW,
    PAPER,
    random_state,
    run_episode,
    sim_1_episode,
    straight_state,
)

# Under (21), phase by phase: the rear wheels that each interval of simulation 1 lifts.
SIM_1 = [
    (1, 85), (2, 54), (3, 60), (4, 60), (4, 60), (5, 27),
    (6, 7), (6, 6), (6, 6), (6, 6), (7, 7), (8, 0),
]  # fmt: skip


def test_select__takes_the_least_j_of_all_valid_modes() -> None:
    optimizer = AnalyticOptimizer(PAPER)
    for seed in range(20):
        state = random_state(seed)
        valid = mode_table(8).valid(state.phase)
        j = {int(mode): predict(state, [mode], PAPER).j[0] for mode in valid}
        selection = optimizer.select(state)
        assert selection.modes.tolist() == list(j)
        assert selection.prediction.j.tolist() == list(j.values())
        if selection.mode is not None:
            assert j[selection.mode] == min(j.values()) < np.inf
            assert selection.last_resort == selection.mode


def test_ties__go_to_the_lowest_mode() -> None:
    state = straight_state()  # a singular shape that nothing moves: all modes cost the same
    selection = AnalyticOptimizer(PAPER).select(state)
    assert len(set(selection.prediction.j[selection.prediction.feasible])) == 1
    assert selection.mode == 0
    candidates = np.zeros((8, 99), dtype=bool)
    candidates[:, 0] = True
    candidates[0, [0, 4]], candidates[0, 0] = True, False
    candidates[0, 60] = True
    assert AnalyticOptimizer(PAPER, candidates).select(state).mode == 4


def test_refused_modes__say_why() -> None:
    seen = set()
    for seed in range(60):
        selection = AnalyticOptimizer(NARROW).select(random_state(seed, NARROW))
        prediction = selection.prediction
        assert np.array_equal(prediction.feasible, prediction.violation == "")
        assert np.array_equal(prediction.feasible, np.isfinite(prediction.j))
        if selection.mode is not None:
            assert prediction.feasible[selection.modes.tolist().index(selection.mode)]
        seen |= set(prediction.violation)
    assert seen == {"", "stability", "joint_limit"}


def test_deadlock__selects_no_mode_and_knows_a_last_resort() -> None:
    selection = AnalyticOptimizer(NARROW).select(DEADLOCK)
    assert selection.mode is None
    assert not selection.prediction.feasible.any()
    longest = selection.prediction.duration.max()
    chosen = selection.modes.tolist().index(selection.last_resort)
    assert selection.prediction.duration[chosen] == longest


def test_candidates__are_the_only_modes_compared() -> None:
    rng = np.random.default_rng(0)
    candidates = rng.random((8, 99)) < 0.2
    candidates[:, 0] = True
    optimizer, full = AnalyticOptimizer(PAPER, candidates), AnalyticOptimizer(PAPER)
    changed = 0
    for seed in range(20):
        state = random_state(seed)
        mask = candidates[state.phase - 1] & mode_table(8).mask(state.phase)
        selection = optimizer.select(state)
        assert selection.modes.tolist() == np.flatnonzero(mask).tolist()
        changed += selection.mode != full.select(state).mode
    assert changed > 5


def test_candidates__of_a_wrong_shape_are_refused() -> None:
    for shape in ((8, 98), (7, 99), (99,)):
        with pytest.raises(InvalidInputError, match=r"^candidates\.shape = .*\(8, 99\)"):
            AnalyticOptimizer(PAPER, np.ones(shape, dtype=bool))


def test_candidates__must_leave_each_phase_a_valid_mode() -> None:
    candidates = np.ones((8, 99), dtype=bool)
    candidates[4] = ~mode_table(8).mask(5)
    with pytest.raises(InvalidInputError, match=r"^candidates = 5: .*at least one valid mode"):
        AnalyticOptimizer(PAPER, candidates)


def test_select__refuses_a_state_that_is_done() -> None:
    with pytest.raises(InvalidInputError, match=r"^state\.phase = 9: expected 1 to 8"):
        AnalyticOptimizer(PAPER).select(straight_state().replace(phase=9))


@pytest.mark.parametrize(
    ("start", "end"),
    [(0.0, 0.0), (0.0, 0.02), (0.0, 0.1), (0.02, 1e-9), (0.05, 0.05), (0.05, -0.05), (0.1, 0.1),
     (-0.05, 0.1), (0.3, 0.3), (0.3, -0.05), (0.3, 0.5), (0.5, 0.0), (0.5, 0.3)],
)  # fmt: skip
def test_constant_curvature__is_left_and_reached(start: float, end: float) -> None:
    states, _, _ = run_episode(SnakeState.initial([start] * 8, [end] * 8, PAPER), PAPER)
    assert states[-1].done
    assert np.abs(states[-1].phi - end).max() < 2 * PAPER.epsilon_p


@pytest.mark.parametrize(("start", "end"), [(0.0, 0.05), (0.05, 0.0), (0.2, 0.1)])
def test_constant_curvature__runs_on_where_21_finds_no_way(start: float, end: float) -> None:
    states, modes, _ = run_episode(SnakeState.initial([start] * 8, [end] * 8, PAPER), PAPER)
    assert len(modes) == PAPER.horizon
    assert states[-1].phase == 7  # where the last two joints depend on each other
    assert all(np.abs(state.phi).max() <= PAPER.phi_limit + 1e-6 for state in states)
    assert np.abs(states[-1].phi[:6] - end).max() < 2 * PAPER.epsilon_p
    assert states[-1].w == pytest.approx(PAPER.w_d, abs=1e-12)


@pytest.mark.parametrize("n", [5, 6, 7, 8, 12])
def test_any_number_of_joints__runs_to_success(n: int) -> None:
    params = SnakeParams(n_joints=n)
    rng = np.random.default_rng(n)
    successes = 0
    for _ in range(4):
        phi0, target = rng.uniform(-0.5, 0.5, (2, n))
        states, _, motions = run_episode(SnakeState.initial(phi0, target, params), params)
        successes += states[-1].done
        assert all(np.abs(motion.phi).max() <= params.phi_limit + 1e-6 for motion in motions)
    assert successes >= 3


@pytest.mark.slow
def test_sixteen_joints__predict_and_advance() -> None:
    params = SnakeParams(n_joints=16)
    phi0, target = np.random.default_rng(0).uniform(-0.4, 0.4, (2, 16))
    state = SnakeState.initial(phi0, target, params)
    modes = np.arange(0, len(mode_table(16)), 163)
    prediction = predict(state, modes, params)
    assert len(modes) > 200
    assert prediction.feasible.any()
    for _ in range(5):
        valid = mode_table(16).valid(state.phase)
        prediction = predict(state, valid[:200], params)
        state, outcome = advance(state, int(valid[np.argmin(prediction.j)]), params)
        assert outcome.feasible[0]
        assert outcome.j[0] == prediction.j.min()
    assert state.elapsed == 15.0


def test_sim_1__runs_as_it_always_did() -> None:
    states, modes, _ = sim_1_episode()
    phases = [state.phase for state in states[:-1]]
    assert list(zip(phases, modes, strict=True)) == SIM_1
    assert states[-1].done
    assert states[-1].elapsed == 36.0
    assert np.abs(states[-1].phi - states[-1].target).max() < 1.5 * PAPER.epsilon_p
    assert states[-1].w == pytest.approx(PAPER.w_d, abs=1e-12)


def test_sim_1__keeps_its_distance_and_its_limits() -> None:
    state = sim_1_episode()[0][0]
    for mode in sim_1_episode()[1]:
        state, prediction = advance(state, mode, PAPER)
        assert prediction.max_abs_phi[0] <= PAPER.phi_limit + PAPER.limit_tolerance
        assert prediction.d_min[0] > 0.18


def _changes(phase_shifts: bool) -> list[float]:
    """Largest change of any joint's input at each switch of the mode, or of the phase."""
    states, _, motions = sim_1_episode()
    return [
        float(np.abs(motions[k].u[0] - motions[k - 1].u[-1]).max())
        for k in range(1, len(motions))
        if (states[k].phase != states[k - 1].phase) == phase_shifts
    ]


def test_sim_1__input_jumps_no_more_at_switches_of_the_mode_than_between_them() -> None:
    _, _, motions = sim_1_episode()
    inside = max(float(np.abs(np.diff(motion.u, axis=0)).max()) for motion in motions)
    changes = _changes(phase_shifts=False)
    assert len(changes) == 4
    assert 0.0 < max(changes) <= inside / 4


def test_sim_1__input_jumps_at_shifts_of_the_phase_only_by_what_18_leaves_over() -> None:
    states, _, motions = sim_1_episode()
    assert len(_changes(phase_shifts=True)) == 7
    for before, after, shifted in zip(motions, motions[1:], states[1:], strict=False):
        if shifted.phase_time == 0.0:
            scp = shifted.phase - 2
            assert np.abs(after.u[0]).max() <= 1e-12  # the next SCP starts from rest
            assert abs(before.u[-1, scp]) <= PAPER.gains[3] * PAPER.epsilon_p
