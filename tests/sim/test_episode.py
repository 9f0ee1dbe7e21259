"""How episodes end, and their figures against the motion inside the intervals."""

import math

import numpy as np
import pytest

from evaluate.protocol import run_episode
from snake_env.modes import mode_table
from snake_env.policies.baselines import AnalyticPolicy
from snake_env.policies.registry import load_policy
from snake_env.sim.episode import OUTCOMES, STILL, Episode, Episodes, EpisodeSummary
from snake_env.sim.simulation import Prediction, advance, advance_batch, predict
from snake_env.sim.tasks import load_tasks
from snake_env.state import SnakeState, StateBatch
from tests.support import oracle
from tests.support.robots import (
    PAPER,
    all_lifted,
    oracle_constants,
    random_state,
    sim_1_episode,
    straight_state,
)


class _Fixed:
    """Always the same mode."""

    rollouts = 0

    def __init__(self, mode: int) -> None:
        self.mode = mode

    def reset(self, seed: int | None = None) -> None:
        pass

    def select_mode(self, state: SnakeState) -> int:
        return self.mode


def _prediction(
    state: SnakeState, violation: str = "", d_min: float = 0.3, cost: float = 0.25
) -> Prediction:
    """A lane that ends in the given state."""
    return Prediction(
        phi=state.phi[None],
        w=state.w[None],
        cost=np.array([cost]),
        j=np.array([math.inf if violation else cost]),
        feasible=np.array([not violation]),
        violation=np.array([violation]),
        d_min=np.array([d_min]),
        max_abs_phi=np.array([abs(state.phi).max()]),
        duration=np.array([3.0]),
    )


def _outcome(
    turn: float, horizon: int, violation: str = "", d_min: float = 0.3, phase: int = 2
) -> str:
    """Outcome after one interval in which joint 5 turns by ``turn``."""
    before = straight_state()
    after = before.replace(phi=turn * np.eye(8)[4], phase=phase)
    episode = Episode(before, PAPER.replace(horizon=horizon))
    assert episode.outcome == ""
    episode.record(after, _prediction(after, violation, d_min))
    assert episode.outcome in ("", *OUTCOMES)
    assert episode.summary().outcome == episode.outcome
    return episode.outcome


def test_outcome__of_one_interval() -> None:
    assert _outcome(0.1, horizon=2) == ""
    assert _outcome(0.0, horizon=2) == ""
    assert _outcome(0.1, horizon=1) == "horizon"
    assert _outcome(-0.1, horizon=1) == "horizon"
    assert _outcome(0.99 * STILL, horizon=1) == "deadlock"
    assert _outcome(-1.01 * STILL, horizon=1) == "horizon"
    assert _outcome(0.1, horizon=1, phase=9) == "success"
    assert _outcome(0.1, horizon=2, violation="stability") == "stability"
    assert _outcome(0.1, horizon=1, violation="joint_limit") == "joint_limit"
    assert _outcome(0.1, horizon=2, d_min=0.0999) == "collision"
    assert _outcome(0.1, horizon=2, d_min=0.1001) == ""
    assert _outcome(0.1, horizon=1, d_min=0.09, phase=9) == "collision"
    assert _outcome(0.1, horizon=1, d_min=0.09, violation="stability") == "stability"


def test_finished_state__is_a_success_at_once() -> None:
    summary = Episode(straight_state().replace(phase=9), PAPER).summary()
    assert (summary.outcome, summary.intervals, summary.time_s) == ("success", 0, 0.0)


def test_figures__add_up_over_intervals() -> None:
    first = straight_state()
    second = first.replace(phi=np.full(8, 0.2), elapsed=3.0, w=np.array([0.3, -0.4, math.pi + 0.1]))
    third = second.replace(phi=np.full(8, -0.1), elapsed=6.0, w=np.array([0.0, 0.1, math.pi - 0.2]))
    episode = Episode(first, PAPER)
    episode.record(second, _prediction(second, d_min=0.25, cost=1.5))
    episode.record(third, _prediction(third, d_min=0.4, cost=0.5))
    summary = episode.summary()
    assert summary == EpisodeSummary(
        outcome="",
        intervals=2,
        time_s=6.0,
        shape_error_rad=float(np.abs(third.phi - third.target).max()),
        phase=1,
        cost_integral=2.0,
        d_min=0.25,
        max_abs_phi=0.2,
        head_error_m=summary.head_error_m,
        head_error_rad=summary.head_error_rad,
    )
    assert summary.head_error_m == pytest.approx(0.5)
    assert summary.head_error_rad == pytest.approx(0.2)


def test_figures__of_sim_1_are_those_of_its_motion() -> None:
    states, modes, motions = sim_1_episode()
    c = oracle_constants(PAPER)
    row = run_episode(load_policy("analytic"), states[0], PAPER, 0)
    phi = np.concatenate([motion.phi for motion in motions])
    assert row["outcome"] == "success"
    assert row["modes"] == " ".join(map(str, modes))
    assert (row["intervals"], row["phase"], row["error"]) == (len(modes), 9, "")
    assert row["time_s"] == 3.0 * len(modes)
    assert row["max_abs_phi"] == abs(phi).max()
    d_min = min(oracle.minimum_distance(np.zeros(3), x, c) for x in phi)
    assert row["d_min"] == pytest.approx(d_min, rel=1e-12)
    cost = sum(
        PAPER.dt * oracle.potential(x, all_lifted(state, mode), state.phase, c)
        for state, mode, motion in zip(states, modes, motions, strict=False)
        for x in motion.phi[:-1]
    )
    assert row["cost_integral"] == pytest.approx(cost, rel=1e-9)
    assert row["rollouts"] == sum((99, 57, 31, 16, 8, 4, 2, 1)[s.phase - 1] for s in states[:-1])


def test_head_error__shrinks_by_the_gains() -> None:
    """Straight and still, k_t = 1: each sub-step of dt = 0.02 leaves 0.98 of x, y, 0.99 of theta."""
    state = straight_state().replace(w=np.array([0.0, 1e-6, math.pi + 1e-6]))
    after, _ = advance(state, 0, PAPER)
    summary = Episode(after, PAPER).summary()
    assert summary.head_error_m == pytest.approx(1e-6 * 0.98**150, rel=1e-6)
    assert summary.head_error_rad == pytest.approx(1e-6 * 0.99**150, rel=1e-6)


def test_head_error__is_the_largest_from_the_start_on() -> None:
    state = straight_state().replace(w=np.array([3e-6, 4e-6, math.pi - 1e-6]))
    after, prediction = advance(state, 0, PAPER)
    episode = Episode(state, PAPER)
    episode.record(after, prediction)
    assert episode.summary().head_error_m == pytest.approx(5e-6)
    assert episode.summary().head_error_rad == pytest.approx(1e-6)


def test_horizon__is_reached_while_still_moving(sim_1: SnakeState) -> None:
    needed = len(sim_1_episode()[1])
    for horizon, outcome in ((needed, "success"), (needed - 1, "horizon"), (1, "horizon")):
        params = PAPER.replace(horizon=horizon)
        row = run_episode(AnalyticPolicy(params), sim_1, params, 0)
        assert (row["outcome"], row["intervals"]) == (outcome, horizon)


def test_deadlock__is_standing_still_at_the_horizon() -> None:
    """Straight to straight, nothing turns: a phase passes per interval, and four are not eight."""
    params = PAPER.replace(horizon=4)
    row = run_episode(_Fixed(0), straight_state(params), params, 0)
    assert (row["outcome"], row["phase"], row["time_s"]) == ("deadlock", 5, 12.0)
    row = run_episode(_Fixed(0), straight_state(), PAPER, 0)
    assert (row["outcome"], row["phase"], row["time_s"]) == ("success", 9, 24.0)


def test_deadlock__of_a_paper_task_is_in_phase_7() -> None:
    state = load_tasks("paper-500", PAPER).initial(422, PAPER)
    row = run_episode(load_policy("analytic"), state, PAPER, 422)
    assert (row["outcome"], row["intervals"], row["phase"]) == ("deadlock", 100, 7)
    assert row["time_s"] == 300.0


def _state_with(violation: str, other_feasible: bool) -> tuple[SnakeState, int]:
    """A state, and a mode that violates at once or later though another would not, or not even."""
    for seed in range(2000):
        state = random_state(seed, PAPER, 4)
        modes = mode_table(8).valid(4)
        prediction = predict(state, modes, PAPER)
        wrong = np.flatnonzero(prediction.violation == violation)
        if len(wrong) and prediction.feasible.any() == other_feasible:
            return state, int(modes[wrong[-1]])
    raise AssertionError("no such state found")


@pytest.mark.parametrize("violation", ["stability", "joint_limit"])
def test_violation__is_named_where_another_mode_was_feasible(violation: str) -> None:
    state, mode = _state_with(violation, other_feasible=True)
    row = run_episode(_Fixed(mode), state, PAPER, 0)
    assert (row["outcome"], row["intervals"], row["modes"]) == (violation, 1, str(mode))
    held = float(predict(state, [mode], PAPER).duration[0])
    assert row["time_s"] == pytest.approx(state.elapsed + held)
    assert (row["max_abs_phi"] > PAPER.phi_limit) == (violation == "joint_limit")


@pytest.mark.parametrize("violation", ["stability", "joint_limit"])
def test_deadlock__is_no_feasible_mode(violation: str) -> None:
    state, mode = _state_with(violation, other_feasible=False)
    row = run_episode(_Fixed(mode), state, PAPER, 0)
    assert (row["outcome"], row["intervals"], row["modes"]) == ("deadlock", 0, "")
    assert row["time_s"] == state.elapsed


def test_collision__ends_an_episode_of_a_wide_robot(sim_1: SnakeState) -> None:
    _, modes, motions = sim_1_episode()
    c = oracle_constants(PAPER)
    zero = np.zeros(3)
    closest = [min(oracle.minimum_distance(zero, x, c) for x in m.phi) for m in motions]
    interval = int(np.argmin(closest))
    params = PAPER.replace(track=closest[interval] + 1e-4)  # a wider track, and nothing else
    episode, state = Episode(sim_1, params), sim_1
    for mode in modes:
        state, prediction = advance(state, mode, params)
        assert prediction.feasible[0]
        episode.record(state, prediction)
        if episode.outcome:
            break
    summary = episode.summary()
    assert (summary.outcome, summary.intervals) == ("collision", interval + 1)
    assert summary.d_min == pytest.approx(closest[interval])


def test_many_episodes__are_followed_as_one_by_one() -> None:
    """Five robots, of which every other interval moves only some; one starts again on the way."""
    params = PAPER.replace(horizon=3, track=0.3)
    start = StateBatch.stack([random_state(seed, params, 2 + seed % 3) for seed in range(5)])
    together, states = Episodes(start, params), start
    alone = [Episode(start[k], params) for k in range(5)]
    seen: set[str] = set()
    for step in range(6):
        moving = np.arange(step % 2, 5)
        after, prediction = advance_batch(states.take(moving), [0] * len(moving), params)
        together.record(moving, after, prediction)
        for lane, k in enumerate(moving):
            alone[k].record(*advance(states[k], 0, params))
            assert after[lane].elapsed == alone[k].summary().time_s
        states = states.put(moving, after)
        if step == 3:
            states = states.put([2], start.take([4]))
            together.restart(np.array([2]), start.take([4]))
            alone[2] = Episode(start[4], params)
        for k in range(5):
            assert together.summary(k) == alone[k].summary()
        seen |= set(together.outcome.tolist())
    assert len(seen) >= 3
