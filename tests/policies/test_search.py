"""The search: expansions, plans that come true, shortest plans, budgets, noise."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies import search as module
from snake_env.policies.search import (
    Budget,
    Plan,
    analytic_plan,
    beam_search,
    expand,
    noise_of,
    search,
)
from snake_env.policies.value import PhaseValue
from snake_env.sim.simulation import advance, predict, predict_batch
from snake_env.sim.tasks import random_suite
from snake_env.state import FloatArray, SnakeState, StateBatch
from tests.support.robots import (
    DEADLOCK,
    FIVE,
    HARDWARE,
    NARROW,
    PAPER,
    random_state,
    run_episode,
    same_state,
    start_of,
    straight_state,
)

EVERYTHING = 10**9  # a beam so wide that nothing is left out
DETOUR = random_suite(2, 3, NARROW).initial(1, NARROW)  # only with noise there is a plan


def _small(seed: int) -> SnakeState:
    """Where a task of five joints begins, all of them near zero: others hardly ever have a plan."""
    phi0, target = np.random.default_rng(seed).uniform(-0.6, 0.6, (2, 5))
    return SnakeState.initial(phi0, target, FIVE)


def _assert_comes_true(plan: Plan, start: SnakeState, params: SnakeParams) -> None:
    assert len(plan) == len(plan.modes) == len(plan.states) > 0
    state, cost = start, 0.0
    for mode, expected in zip(plan.modes, plan.states, strict=True):
        assert type(mode) is int
        assert same_state(state, expected)
        state, prediction = advance(state, mode, params)
        assert prediction.feasible[0]
        cost += float(prediction.cost[0])
    assert state.done
    assert cost == plan.cost


def _late(phase: int, seed: int, params: SnakeParams = PAPER) -> SnakeState:
    """A state of a phase on the way of (21) to a random target."""
    for task in itertools.count(seed):
        states, _, _ = run_episode(start_of(0, params, task), params)
        for state in states:
            if state.phase == phase:
                return state
    raise AssertionError


def _shortest(start: SnakeState, longest: int, params: SnakeParams) -> tuple[int, float] | None:
    """Intervals, and least cost, of the shortest plans: every mode of every state is tried."""
    level = [(start, 0.0)]
    for step in range(1, longest + 1):
        found = []
        for state, cost in level:
            modes = mode_table(params.n_joints).valid(state.phase)
            for mode in modes[predict(state, modes, params).feasible]:
                after, prediction = advance(state, int(mode), params)
                found.append((after, cost + float(prediction.cost[0])))
        done = [cost for state, cost in found if state.done]
        if done:
            return step, min(done)
        level = found
    return None


@pytest.mark.parametrize("params", [PAPER, FIVE, NARROW, HARDWARE])
def test_expand__is_predict_and_advance_mode_by_mode(params: SnakeParams) -> None:
    phases = [1, *range(3, params.n_joints + 1), 3]
    states = [random_state(seed, params, phase) for seed, phase in enumerate(phases)]
    tree = expand(StateBatch.stack(states), params)
    at, valid_modes = 0, 0
    for parent, state in enumerate(states):
        valid = mode_table(params.n_joints).valid(state.phase)
        prediction = predict(state, valid, params)
        valid_modes += len(valid)
        for mode, cost in zip(
            valid[prediction.feasible], prediction.cost[prediction.feasible], strict=True
        ):
            assert (tree.parent[at], tree.mode[at], tree.cost[at]) == (parent, mode, cost)
            assert same_state(tree.states[at], advance(state, int(mode), params)[0])
            at += 1
    assert at == len(tree.parent) == len(tree.mode) == len(tree.cost) == len(tree.states) > 10
    assert at < tree.rollouts == valid_modes


def test_expand__of_states_without_a_way_on_is_empty() -> None:
    states = StateBatch.stack([straight_state().replace(phase=9)])
    tree = expand(states, PAPER)
    assert (len(tree.mode), len(tree.states), tree.rollouts) == (0, 0, 0)
    assert not predict(DEADLOCK, mode_table(8).valid(7), NARROW).feasible.any()
    tree = expand(StateBatch.stack([DEADLOCK, DEADLOCK]), NARROW)
    assert (len(tree.mode), len(tree.states), tree.rollouts) == (0, 0, 4)


def test_plan__is_better_if_shorter_then_if_cheaper() -> None:
    state = straight_state()
    two, cheap = Plan([0, 1], [state] * 2, 9.0), Plan([2, 3], [state] * 2, 8.0)
    three = Plan([0, 1, 2], [state] * 3, 1.0)
    assert cheap.better_than(two)
    assert not two.better_than(cheap)
    assert not two.better_than(two)
    assert two.better_than(three)
    assert not three.better_than(two)
    assert three.better_than(None)


def test_plan__has_a_rest() -> None:
    state = straight_state()
    plan = Plan([4, 5, 6], [state, state.replace(phase=2), state.replace(phase=3)], 1.0)
    rest = plan.rest()
    assert (list(rest.modes), [state.phase for state in rest.states]) == ([5, 6], [2, 3])
    assert len(plan) == 3


def test_analytic_plan__is_the_episode_of_21() -> None:
    for task in range(4):
        start, budget = start_of(task), Budget()
        states, modes, _ = run_episode(start, PAPER)
        plan = analytic_plan(start, PAPER, len(modes), budget)
        assert plan is not None
        assert plan.modes == modes
        _assert_comes_true(plan, start, PAPER)
        assert budget.spent == sum(len(mode_table(8).valid(state.phase)) for state in states[:-1])
        assert analytic_plan(start, PAPER, len(modes) - 1, Budget()) is None


@pytest.mark.parametrize("params", [PAPER, FIVE, NARROW, HARDWARE])
@pytest.mark.parametrize("depth", [None, 1, 3])
def test_plan_found__comes_true(params: SnakeParams, depth: int | None) -> None:
    found = 0
    for task in range(3):
        start = _small((1, 7, 8)[task]) if params is FIVE else start_of(task, params)
        plan = beam_search(
            start, PhaseValue(params), params, width=6, longest=40, budget=Budget(), depth=depth
        )
        if plan is not None:
            _assert_comes_true(plan, start, params)
            found += 1
    assert found >= 2


def test_plan_found__comes_true_from_the_middle_of_a_phase() -> None:
    found = 0
    for seed in range(20):
        start = random_state(seed, PAPER, 5 + seed % 4)
        plan = search(start, PhaseValue(PAPER), PAPER, width=4, budget=Budget(rollouts=1000))
        if plan is not None:
            _assert_comes_true(plan, start, PAPER)
            found += start.phase_time > 0.0
    assert found >= 3


@pytest.mark.parametrize(
    ("phase", "tasks"), [(6, [0, 10, 20, 30]), (7, [20, 30, 40, 50]), (8, [50, 60, 70])]
)
def test_beam__that_leaves_nothing_out_finds_the_shortest_plan(
    phase: int, tasks: list[int]
) -> None:
    lengths = [_agreed(_late(phase, task), 5, PAPER) for task in tasks]
    assert max(length for length in lengths if length) > 9 - phase  # a phase takes several


def test_beam__that_leaves_nothing_out_finds_the_shortest_plan_of_five_joints() -> None:
    lengths = [_agreed(_small(seed), 7, FIVE) for seed in (1, 7)]
    assert lengths == [5, 7]
    assert _agreed(_small(0), 4, FIVE) is None


def _agreed(start: SnakeState, longest: int, params: SnakeParams) -> int | None:
    """The length of the shortest plan, on which the beam and the exhaustive search agree."""
    value = PhaseValue(params)
    expected = _shortest(start, longest, params)
    plan = beam_search(start, value, params, width=EVERYTHING, longest=longest, budget=Budget())
    if expected is None:
        assert plan is None
        return None
    assert plan is not None
    assert len(plan) == expected[0]
    assert plan.cost == pytest.approx(expected[1], rel=0.02)  # similar states count as one
    assert plan.cost >= expected[1] - 1e-12
    shorter = len(plan) - 1
    assert not beam_search(start, value, params, width=EVERYTHING, longest=shorter, budget=Budget())
    return len(plan)


def test_beam__is_never_longer_than_asked() -> None:
    start, value = start_of(0), PhaseValue(PAPER)
    whole = beam_search(start, value, PAPER, width=4, longest=40, budget=Budget())
    assert whole is not None
    for longest in (0, 1, len(whole) - 1):
        budget = Budget()
        plan = beam_search(start, value, PAPER, width=4, longest=longest, budget=budget)
        assert plan is None
    again = beam_search(start, value, PAPER, width=4, longest=len(whole), budget=Budget())
    assert again is not None
    assert again.modes == whole.modes


def test_beam__follows_the_value() -> None:
    """Of two modes the one that the value prefers, even where the other is better."""
    start = start_of(0)
    first = expand(StateBatch.stack([start]), PAPER)
    for wanted in (int(first.mode[3]), int(first.mode[-1])):

        def value(states: StateBatch, wanted: int = wanted) -> FloatArray:
            begun = states.elapsed == PAPER.delta_t
            return np.where(begun & (states.last_mode != wanted), 100.0, PhaseValue(PAPER)(states))

        plan = beam_search(start, value, PAPER, width=1, longest=40, budget=Budget())
        assert plan is not None
        assert plan.modes[0] == wanted


def test_beam__with_a_depth_follows_each_state_to_its_own_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trees: list[module.Expansion] = []
    beams: list[StateBatch] = []

    def noting(states: StateBatch, params: SnakeParams) -> module.Expansion:
        beams.append(states)
        trees.append(expand(states, params))
        return trees[-1]

    monkeypatch.setattr(module, "expand", noting)
    plan = beam_search(
        start_of(0), PhaseValue(PAPER), PAPER, width=5, longest=40, budget=Budget(), depth=2
    )
    assert plan is not None
    assert len(beams) == len(plan)
    assert [len(beam) for beam in beams[:3]] == [1, 5, 5]
    parents = []
    for tree, beam in zip(trees, beams[1:], strict=False):
        at = [np.flatnonzero((tree.states.phi == phi).all(axis=1))[0] for phi in beam.phi]
        parents.append(tree.parent[at].tolist())
        for k, state in zip(at, tree.parent[at], strict=True):  # the best of its own
            own = tree.states.take(np.flatnonzero(tree.parent == state))
            ranks = PhaseValue(PAPER)(own)
            assert PhaseValue(PAPER)(tree.states)[k] == ranks.min() or len(parents) <= 2
    assert len(set(parents[1])) < 5  # they still compete
    assert all(len(set(each)) == len(each) for each in parents[2:])


def _counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many modes each later call of the kernel predicts for a search."""
    lanes: list[int] = []

    def counting(states: StateBatch, modes: FloatArray, params: SnakeParams) -> object:
        lanes.append(len(states))
        return predict_batch(states, modes, params)

    monkeypatch.setattr(module, "predict_batch", counting)
    return lanes


@pytest.mark.parametrize("rollouts", [1, 99, 100, 2_000, 10_000])
def test_budget__is_exceeded_by_one_level_at_most(
    rollouts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, width, budget = start_of(2), 8, Budget(rollouts=rollouts)
    lanes = _counted(monkeypatch)
    plan = beam_search(start, PhaseValue(PAPER), PAPER, width=width, longest=100, budget=budget)
    assert budget.spent == sum(lanes)
    assert budget.rollouts == rollouts - budget.spent
    assert budget.spent - lanes[-1] < rollouts
    assert (plan is None) == budget.exhausted


@pytest.mark.parametrize("rollouts", [1, 300, 1_000, 3_000, 6_000])
def test_search__keeps_its_budget_and_what_it_has_found(rollouts: int) -> None:
    start, width, budget = start_of(0), 16, Budget(rollouts=rollouts)
    greedy = analytic_plan(start, PAPER, 100, Budget())
    plan = search(start, PhaseValue(PAPER), PAPER, width=width, budget=budget, restarts=100)
    assert rollouts <= budget.spent < rollouts + 99 * width or not budget.exhausted
    if rollouts >= 1_000:  # enough for (21)
        assert plan is not None
        assert not greedy.better_than(plan)
    else:
        assert plan is None


class _Clock:
    """Tells a second more each time that it is asked."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        self.now += 1.0
        return self.now


@pytest.mark.parametrize("deadline", [1, 2, 4])
def test_deadline__ends_the_search_at_the_next_level(
    deadline: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    lanes = _counted(monkeypatch)
    monkeypatch.setattr(module, "time", _Clock())
    plan = beam_search(
        start_of(0), PhaseValue(PAPER), PAPER, width=2, longest=40, budget=Budget(deadline=deadline)
    )
    assert plan is None
    assert len(lanes) == deadline - 1


def test_deadline__that_has_passed_leaves_no_time_for_anything() -> None:
    budget = Budget(deadline=0.0)
    plan = search(start_of(0), PhaseValue(PAPER), PAPER, width=64, budget=budget, restarts=10**6)
    assert plan is None
    assert budget.spent == 0


def test_deadline__keeps_the_best_plan_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    start = start_of(0)
    greedy = analytic_plan(start, PAPER, 100, Budget())
    assert greedy is not None
    monkeypatch.setattr(module, "time", _Clock())
    budget = Budget(deadline=len(greedy) + 2.5)  # (21), and two levels of the first beam
    plan = search(start, PhaseValue(PAPER), PAPER, width=64, budget=budget)
    assert plan is not None
    assert plan.modes == greedy.modes


def _constant(states: StateBatch) -> FloatArray:
    return np.zeros(len(states))


def _misled(states: StateBatch) -> FloatArray:
    return -PhaseValue(PAPER)(states)


@pytest.mark.parametrize("value", [PhaseValue(PAPER), _constant, _misled])
@pytest.mark.parametrize("width", [1, 6])
def test_search__is_never_worse_than_21(
    value: Callable[[StateBatch], FloatArray], width: int
) -> None:
    for task in range(3):
        start = start_of(task)
        greedy = analytic_plan(start, PAPER, 100, Budget())
        plan = search(start, value, PAPER, width=width, budget=Budget())
        assert greedy is not None
        assert plan is not None
        assert not greedy.better_than(plan)
        _assert_comes_true(plan, start, PAPER)


def test_search__keeps_the_cheaper_of_equally_short_plans() -> None:
    states, _, _ = run_episode(start_of(0, seed=1), PAPER)
    costlier = 0
    for start in states[7:13]:
        greedy = analytic_plan(start, PAPER, 100, Budget())
        assert greedy is not None
        value, longest = PhaseValue(PAPER), len(greedy)
        beam = beam_search(start, value, PAPER, width=1, longest=longest, budget=Budget())
        costlier += beam is not None and greedy.better_than(beam)
        plan = search(start, value, PAPER, width=1, budget=Budget())
        assert plan is not None
        assert not greedy.better_than(plan)
    assert costlier >= 3


def test_search__shortens_most_plans_of_21() -> None:
    shorter = 0
    for task in range(6):
        greedy = analytic_plan(start_of(task), PAPER, 100, Budget())
        plan = search(start_of(task), PhaseValue(PAPER), PAPER, width=16, budget=Budget())
        assert greedy is not None
        assert plan is not None
        shorter += len(plan) < len(greedy)
    assert shorter >= 4


def test_search__looks_no_further_than_the_horizon() -> None:
    start = start_of(0)
    plan = search(start, PhaseValue(PAPER), PAPER, width=4, budget=Budget())
    assert plan is not None
    for left, solvable in ((len(plan), True), (len(plan) - 1, False), (1, False)):
        late = start.replace(elapsed=PAPER.delta_t * (PAPER.horizon - left))
        found = search(late, PhaseValue(PAPER), PAPER, width=4, budget=Budget())
        assert (found is not None) == solvable
        assert found is None or len(found) == left


def test_same_shapes__are_followed_once_in_each_phase() -> None:
    state = _late(7, 0)
    twin = state.replace(phi=state.phi + 1e-6)
    other = state.replace(phi=state.phi + 0.1)
    earlier = state.replace(phase=6)
    best = module._best  # nothing else shows which states a beam keeps
    rank = np.array([0.0, 1.0, 2.0, 3.0])
    batch = StateBatch.stack([state, twin, earlier, other])
    assert best(batch, rank, 2).tolist() == [0, 2]
    assert best(batch, rank, 3).tolist() == [0, 2, 3]
    assert best(batch, rank, 9).tolist() == [0, 2, 3]
    assert best(batch, -rank, 1).tolist() == [3]
    assert best(batch, np.zeros(4), 2).tolist() == [0, 2]  # ties: the first


def test_noise__is_reproducible_and_no_tasks() -> None:
    draws = {seed: tuple(noise_of(seed).random(4)) for seed in range(20)}
    assert draws == {seed: tuple(noise_of(seed).random(4)) for seed in range(20)}
    assert len(set(draws.values())) == 20
    tasks = {
        tuple(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(task,))).random(4))
        for seed in range(20)
        for task in range(5)
    }
    assert not tasks & set(draws.values())


def test_noisy_search__finds_other_plans_and_each_again() -> None:
    start, value = start_of(0), PhaseValue(PAPER)

    def found(seed: int | None) -> tuple[int, ...]:
        noise = None if seed is None else noise_of(seed)
        plan = beam_search(start, value, PAPER, width=4, longest=60, budget=Budget(), noise=noise)
        assert plan is not None
        _assert_comes_true(plan, start, PAPER)
        return tuple(plan.modes)

    plans = [found(seed) for seed in (None, 0, 1, 2)]
    assert [found(seed) for seed in (None, 0, 1, 2)] == plans
    assert len(set(plans)) == 4


def test_restarts__find_a_way_where_there_is_none_without_noise() -> None:
    params = NARROW.replace(horizon=25)
    value = PhaseValue(params)
    assert search(DETOUR, value, params, width=8, budget=Budget()) is None
    plans = [
        search(DETOUR, value, params, width=8, budget=Budget(), restarts=8, seed=0)
        for _ in range(2)
    ]
    assert plans[0] is not None
    assert plans[1] is not None
    assert plans[0].modes == plans[1].modes
    _assert_comes_true(plans[0], DETOUR, params)


def test_restarts__end_where_there_is_no_way() -> None:
    budget = Budget()
    plan = search(DEADLOCK, PhaseValue(NARROW), NARROW, width=8, budget=budget, restarts=3)
    assert plan is None
    assert budget.spent == 2 * (1 + 2 + 3)  # (21), beams of 2 and 8, restarts: 2 modes each
