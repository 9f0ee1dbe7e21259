"""The shortest plans that are found: they come true, and the search never loses one."""

import itertools

import pytest

from evaluate import plans as module
from evaluate.plans import COLUMNS, FIRST_WIDTH, Problem, Row, dead_end, replay, solve
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.search import Budget, Plan, analytic_plan, beam_search, search
from snake_env.policies.value import PhaseValue
from snake_env.sim.simulation import advance, predict
from snake_env.sim.tasks import load_tasks, random_suite
from snake_env.state import SnakeState
from tests.support.robots import DEADLOCK, NARROW, PAPER, random_state, same_state, sim_1_episode


def _problem(task: int = 0, rollouts: int = 6_000, known: tuple[int, ...] = ()) -> Problem:
    state = random_suite(task + 1, 3, PAPER).initial(task, PAPER)
    return Problem(task, state, known, rollouts, PAPER)


def _modes(row: Row) -> tuple[int, ...]:
    return tuple(map(int, row["modes"].split()))


def _greedy(state: SnakeState) -> Plan:
    plan = analytic_plan(state, PAPER, 100, Budget())
    assert plan is not None
    return plan


def test_replay__is_the_episode() -> None:
    states, modes, _ = sim_1_episode()
    plan = replay(states[0], tuple(modes), PAPER)
    assert plan is not None
    assert list(plan.modes) == modes
    assert all(itertools.starmap(same_state, zip(plan.states, states[:-1], strict=True)))
    assert plan.cost == _greedy(states[0]).cost


def test_replay__of_modes_that_end_elsewhere_is_nothing() -> None:
    states, modes, _ = sim_1_episode()
    assert replay(states[0], (), PAPER) is None
    assert replay(states[0], tuple(modes[:-1]), PAPER) is None
    assert replay(states[1], tuple(modes[2:]), PAPER) is None


def test_replay__of_modes_that_break_a_limit_is_nothing() -> None:
    states, modes, _ = sim_1_episode()
    valid = mode_table(8).valid(1)
    broken = int(valid[~predict(states[0], valid, PAPER).feasible][0])
    assert replay(states[0], (broken, *modes[1:]), PAPER) is None


def test_solve__finds_a_plan_that_comes_true() -> None:
    for task in range(3):
        problem = _problem(task)
        row = solve(problem)
        assert tuple(row) == COLUMNS
        assert row["task"] == task
        state, cost = problem.state, 0.0
        for mode in _modes(row):
            state, prediction = advance(state, mode, PAPER)
            assert prediction.feasible[0]
            cost += float(prediction.cost[0])
        assert state.done
        assert row["intervals"] == len(_modes(row))
        assert row["time_s"] == state.elapsed == 3.0 * row["intervals"]
        assert row["cost"] == pytest.approx(cost, abs=1e-6)
        assert row["rollouts"] >= 6_000
        assert row["width"] >= FIRST_WIDTH


def test_solve__is_never_worse_than_21_and_better_with_time() -> None:
    shorter = 0
    for task in range(3):
        greedy = _greedy(_problem(task).state)
        lengths = [len(greedy)]
        for rollouts in (2_000, 6_000, 12_000):
            row = solve(_problem(task, rollouts))
            assert (row["intervals"], row["cost"]) <= (len(greedy), greedy.cost + 1e-6)
            lengths.append(row["intervals"])
        assert lengths == sorted(lengths, reverse=True)
        shorter += lengths[-1] < lengths[0]
    assert shorter >= 2


def test_solve__is_reproducible() -> None:
    assert solve(_problem(1)) == solve(_problem(1))


@pytest.mark.parametrize("rollouts", [1, 3_000])
def test_solve__begins_with_the_known_plan_and_never_loses_it(rollouts: int) -> None:
    for task in range(2):
        best = solve(_problem(task, 8_000))
        again = solve(_problem(task, rollouts, known=_modes(best)))
        assert (again["intervals"], again["cost"]) <= (best["intervals"], best["cost"])
        assert replay(_problem(task).state, _modes(again), PAPER) is not None


def test_solve__replaces_a_known_plan_by_a_shorter_one() -> None:
    problem = _problem()
    greedy = tuple(_greedy(problem.state).modes)
    row = solve(_problem(known=greedy, rollouts=8_000))
    assert row["intervals"] < len(greedy)


def test_solve__does_without_a_known_plan_that_does_not_come_true() -> None:
    other = tuple(_greedy(_problem(1).state).modes)
    assert solve(_problem(known=other)) == solve(_problem())


def test_solve__without_a_plan_says_how_hard_it_was_tried() -> None:
    row = solve(_problem(rollouts=1))
    assert tuple(row) == COLUMNS
    assert [row[name] for name in ("intervals", "time_s", "cost", "modes")] == [""] * 4
    assert row["rollouts"] == 99  # what the budget allowed was begun
    assert row["width"] == 0  # (21) alone


def test_solve__with_little_more_tells_the_width() -> None:
    greedy = Budget()
    analytic_plan(_problem().state, PAPER, 100, greedy)
    row = solve(_problem(rollouts=greedy.spent + 1))
    assert row["width"] == FIRST_WIDTH


def test_solve__says_that_a_task_is_impossible() -> None:
    row = solve(Problem(5, DEADLOCK, (), 2_000, NARROW))
    assert row == {
        "task": 5, "intervals": "", "time_s": "", "cost": "", "rollouts": 4, "width": 0,
        "impossible": 1, "phase": 7, "modes": "",
    }  # fmt: skip


def test_solve__tries_noise_and_another_value_where_there_is_no_plan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[tuple[str, bool, int]] = []

    def nothing(state, value, params, *, width, longest, noise, budget) -> None:
        assert longest == params.horizon
        tried.append((type(value).__name__, noise is not None, width))
        budget.spend(100)

    class Learned(module.PhaseValue):
        """Stands for a trained network."""

        def __init__(self, params: SnakeParams, transfer: bool) -> None:
            super().__init__(params)

    monkeypatch.setattr(module, "analytic_plan", lambda *_: None)
    monkeypatch.setattr(module, "dead_end", lambda *_: None)
    monkeypatch.setattr(module, "beam_search", nothing)
    monkeypatch.setattr(module, "load_value", Learned)
    row = solve(_problem(rollouts=701))
    four = [(value, noise) for noise in (False, True) for value in ("Learned", "PhaseValue")]
    assert tried == [(*each, width) for width in (8, 16) for each in four]
    assert (row["rollouts"], row["width"], row["impossible"]) == (800, 16, 0)


def test_solve__tries_the_value_alone_where_there_is_a_plan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    widths = []

    def noting(*arguments, width, noise, **options):
        assert noise is None
        widths.append(width)
        return beam_search(*arguments, width=width, noise=noise, **options)

    monkeypatch.setattr(module, "beam_search", noting)
    row = solve(_problem(rollouts=12_000))
    assert len(widths) > 1
    assert widths == [8 * 2**k for k in range(len(widths))]
    assert row["width"] == widths[-1]


def test_dead_end__is_found_where_nothing_is_feasible() -> None:
    budget = Budget()
    assert dead_end(DEADLOCK, NARROW, budget) == 7
    assert budget.spent == 2


def test_dead_end__is_none_where_there_is_a_way() -> None:
    states, _, _ = sim_1_episode()
    for state in states[:-1:3]:
        assert dead_end(state, PAPER, Budget(rollouts=2_000)) is None


def _reached(state: SnakeState, depth: int, params: SnakeParams) -> int:
    """The furthest phase that any way leads to in so many intervals."""
    if depth == 0 or state.done:
        return state.phase
    modes = mode_table(params.n_joints).valid(state.phase)
    ways = modes[predict(state, modes, params).feasible]
    after = [_reached(advance(state, int(mode), params)[0], depth - 1, params) for mode in ways]
    return max([state.phase, *after])


def test_dead_end__agrees_with_an_exhaustive_search() -> None:
    verdicts = []
    for seed in range(60):
        state = random_state(seed, NARROW, 6 + seed % 3)
        budget = Budget(rollouts=3_000)
        furthest = dead_end(state, NARROW, budget)
        reached = _reached(state, 4, NARROW)
        if furthest is not None:
            assert state.phase <= reached <= furthest <= 8
        elif not budget.exhausted:
            plan = search(state, PhaseValue(NARROW), NARROW, width=10**6, budget=Budget())
            assert plan is not None
        verdicts.append((furthest is None, furthest == state.phase, budget.exhausted))
    seen = {verdict: verdicts.count(verdict) for verdict in set(verdicts)}
    assert seen[True, False, False] >= 5  # there is a way
    assert seen[False, True, False] >= 5  # nothing leads out of the phase
    assert seen[False, False, False] >= 1  # something does, but not to the target


def test_dead_end__is_not_claimed_when_the_budget_ends() -> None:
    state, whole = random_state(0, NARROW, 6), Budget()
    assert dead_end(state, NARROW, whole) == 7
    for rollouts in range(1, whole.spent):
        budget = Budget(rollouts=rollouts)
        furthest = dead_end(state, NARROW, budget)
        assert furthest is None or budget.spent == whole.spent
    assert dead_end(state, NARROW, Budget(rollouts=1)) is None


def test_solve__finds_a_way_where_21_finds_none() -> None:
    state = load_tasks("paper-500", PAPER).initial(422, PAPER)
    assert analytic_plan(state, PAPER, 100, Budget()) is None
    row = solve(Problem(422, state, (), 20_000, PAPER))
    plan = replay(state, _modes(row), PAPER)
    assert plan is not None
    assert len(plan) == row["intervals"] <= 25


def test_plans__let_no_links_touch(monkeypatch: pytest.MonkeyPatch) -> None:
    states, modes, _ = sim_1_episode()
    assert replay(states[0], tuple(modes), PAPER) is not None
    monkeypatch.setattr(SnakeParams, "d_touch", property(lambda params: 1.0))  # whatever they do
    assert replay(states[0], tuple(modes), PAPER) is None
    assert analytic_plan(states[0], PAPER, 100, Budget()) is None
