"""The teacher: what modes cost, and the states that are collected."""

import itertools

import numpy as np
import pytest

from agents.failures import failure_cost
from agents.labels import STATE_FIELDS, Decisions
from agents.teacher import FEW, Visit, collect, label
from snake_env.modes import mode_table
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.policies.value import PhaseValue, network_value, pretrained
from snake_env.sim.masks import action_masks
from snake_env.sim.observation import observation_size
from snake_env.sim.simulation import advance, predict
from snake_env.state import SnakeState, StateBatch
from tests.support.models import model_of
from tests.support.robots import DEADLOCK, FIVE, NARROW, PAPER, random_state, same_state


def _student(n_joints: int, highest: bool) -> Network:
    """Always prefers the lowest mode, or the highest."""
    logits = np.arange(len(mode_table(n_joints)), dtype=np.float32)
    shape = observation_size(n_joints), len(logits)
    return Network([np.zeros(shape, np.float32)], [logits if highest else -logits])


def _value(n_joints: int) -> Network:
    """A value network with random weights."""
    return model_of(n_joints, n_joints, "value").network


def _visit(params: SnakeParams = FIVE, **changes: object) -> Visit:
    options = {
        "seed": 0, "part": 0, "decisions": 150, "value": _value(params.n_joints),
        "student": None, "oversampling": 1.0, "params": params,
    }  # fmt: skip
    return Visit(**(options | changes))  # type: ignore[arg-type]


def _collected(params: SnakeParams = FIVE, **changes: object) -> Decisions:
    return collect(_visit(params, **changes))[1]


def _same(one: Decisions, other: Decisions) -> bool:
    return (
        all(
            np.array_equal(getattr(one.states, name), getattr(other.states, name))
            for name in STATE_FIELDS
        )
        and np.array_equal(one.mask, other.mask)
        and np.array_equal(one.feasible, other.feasible)
        and np.array_equal(one.cost_to_go, other.cost_to_go)
    )


@pytest.mark.parametrize("params", [PAPER, FIVE, NARROW])
def test_costs__say_what_is_feasible(params: SnakeParams) -> None:
    n = params.n_joints
    states = [random_state(seed, params, max(1, n - seed)) for seed in range(n - 1)]
    decisions = label(StateBatch.stack(states), PhaseValue(params), params)
    shape = (n - 1, len(mode_table(n)))
    assert decisions.mask.shape == decisions.feasible.shape == decisions.cost_to_go.shape == shape
    for k, state in enumerate(states):
        valid = mode_table(n).valid(state.phase)
        feasible = np.zeros(shape[1], dtype=bool)
        feasible[valid] = predict(state, valid, params).feasible
        assert np.array_equal(decisions.feasible[k], feasible)
        assert np.array_equal(np.isfinite(decisions.cost_to_go[k]), feasible)
        assert decisions.cost_to_go[k].min() >= 1.0
        assert (decisions.cost_to_go[k][feasible] <= 1.0 + failure_cost(params)).all()
        assert same_state(decisions.states[k], state)
    assert np.array_equal(decisions.mask, action_masks(decisions.states, params, "instant"))
    assert decisions.feasible.any()
    assert not decisions.feasible[decisions.feasible.any(axis=1)].all(axis=1).any()


def _after(state: SnakeState, params: SnakeParams) -> dict[int, SnakeState]:
    """Where each feasible mode leads."""
    valid = mode_table(params.n_joints).valid(state.phase)
    feasible = valid[predict(state, valid, params).feasible]
    return {int(mode): advance(state, int(mode), params)[0] for mode in feasible}


def test_cost__is_one_interval_and_the_value_of_its_end() -> None:
    """Against one state at a time; nothing costs more than a failure, nor less than the interval."""
    value = network_value(_value(8), PAPER)
    checked, bounds = 0, set()
    for seed in range(8):
        state = random_state(seed, PAPER, 5 + seed % 4)

        def worth(states: StateBatch) -> np.ndarray:
            return 40.0 * value(states)  # far beyond both bounds

        (cost,) = label(StateBatch.stack([state]), worth, PAPER).cost_to_go
        for mode, after in _after(state, PAPER).items():
            raw = float(worth(StateBatch.stack([after]))[0])
            assert cost[mode] == pytest.approx(
                1.0 + min(max(raw, 0.0), failure_cost(PAPER)), abs=1e-4
            )
            bounds |= {raw < 0.0, raw > failure_cost(PAPER)}
            checked += 1
    assert checked > 20
    assert bounds == {True, False}


def test_costs__of_a_deadlock_are_infinite() -> None:
    decisions = label(StateBatch.stack([DEADLOCK] * 2), PhaseValue(NARROW), NARROW)
    assert not decisions.feasible.any()
    assert np.isinf(decisions.cost_to_go).all()
    assert len(decisions) == 2


def test_collect__gives_just_as_many_decisions_as_asked() -> None:
    for decisions in (1, 64, 333):
        part, found = collect(_visit(part=7, decisions=decisions))
        assert part == 7
        assert len(found) == decisions
        choices = mode_table(5).masks(found.states.phase).sum(axis=1)
        assert choices.min() > 1  # between a single mode there is nothing to decide
        assert found.states.phase.max() <= 5


def test_collect__has_the_costs_of_its_states() -> None:
    eleven = Network(
        [np.zeros((observation_size(5), 1), np.float32)], [np.full(1, 11.0, np.float32)]
    )
    for network in (_value(5), eleven):
        found = _collected(value=network, decisions=80)
        assert _same(found, label(found.states, network_value(network, FIVE), FIVE))
    assert set(found.cost_to_go[found.feasible]) == {12.0}  # none of them reaches the target


def test_slip__moves_the_heads_of_those_that_are_visited() -> None:
    dry, wet = (_collected(PAPER, decisions=300, slip=slip) for slip in ((0, 0), (0.01, 0.05)))
    off = [np.abs(found.states.w - PAPER.w_d).max(axis=1) for found in (dry, wet)]
    begun = [found.states.elapsed == 0.0 for found in (dry, wet)]
    assert off[0].max() < 1e-9
    assert off[1][begun[1]].max() == 0.0
    assert (off[1][~begun[1]] > 1e-4).mean() > 0.9
    assert _same(wet, _collected(PAPER, decisions=300, slip=(0.01, 0.05)))


def test_collect__is_decided_by_seed_and_part() -> None:
    found = {key: _collected(seed=key[0], part=key[1]) for key in ((0, 0), (0, 1), (1, 0))}
    for (seed, part), decisions in found.items():
        assert _same(decisions, _collected(seed=seed, part=part))
    for one, other in itertools.combinations(found.values(), 2):
        shapes = {row.tobytes() for row in one.states.target}
        assert not shapes & {row.tobytes() for row in other.states.target}


def _steps(decisions: Decisions) -> list[tuple[int, int]]:
    """Pairs of decisions that follow each other in an episode."""
    at = {
        (target.tobytes(), round(float(elapsed), 6)): k
        for k, (target, elapsed) in enumerate(
            zip(decisions.states.target, decisions.states.elapsed, strict=True)
        )
    }
    pairs = [(at.get((target, round(elapsed - 3.0, 6))), k) for (target, elapsed), k in at.items()]
    return [(before, k) for before, k in pairs if before is not None]


def test_collect__visits_the_states_of_a_student() -> None:
    found = _collected(PAPER, student=_student(8, highest=False), decisions=300)
    steps = _steps(found)
    assert len(steps) > 100
    for before, after in steps:
        assert found.feasible[before, 0]
        assert found.states.last_mode[after] == 0
    other = _collected(PAPER, decisions=300)
    assert np.mean(other.states.last_mode == 0) < 0.3


@pytest.mark.parametrize("params", [NARROW, PAPER])
def test_collect__goes_on_with_the_teacher_where_the_student_fails(params: SnakeParams) -> None:
    found = _collected(params, student=_student(params.n_joints, highest=True), decisions=400)
    followed = refused = 0
    for before, after in _steps(found):
        chosen = found.states.last_mode[after]
        assert found.feasible[before, chosen]
        wish = np.flatnonzero(found.mask[before])[-1]
        followed += chosen == wish
        refused += chosen != wish
        assert (chosen == wish) == found.feasible[before, wish]
    assert followed > 50
    assert refused > 5


def test_collect__follows_its_teacher_in_half_of_the_episodes() -> None:
    found = _collected(PAPER, decisions=900)
    strict: dict[bytes, bool] = {}
    states, steps = found.states, _steps(found)
    for before, after in steps:
        target = states.target[after].tobytes()
        best = int(found.cost_to_go[before].argmin())
        strict[target] = strict.get(target, True) and states.last_mode[after] == best
    assert len(strict) >= 64
    assert 0.35 < np.mean(list(strict.values())) < 0.75  # noise may change nothing
    for before, after in steps:
        assert same_state(
            states[after], advance(states[before], int(states.last_mode[after]), PAPER)[0]
        )


def _near_deadlock(decisions: Decisions) -> float:
    """The share of states with a choice of which at most three are feasible."""
    valid = mode_table(8).masks(decisions.states.phase).sum(axis=1)
    near = (decisions.feasible.sum(axis=1) <= FEW) & (valid > FEW)
    return float(near.mean())


def test_oversampling__keeps_more_states_near_a_deadlock() -> None:
    model = pretrained(NARROW, "value")  # it comes far enough
    assert model is not None
    value = model.network
    plain, often = (
        _near_deadlock(
            _collected(NARROW, seed=2, decisions=1500, value=value, oversampling=oversampling)
        )
        for oversampling in (1.0, 4.0)
    )
    assert 0.01 < plain < 0.3
    odds = plain / (1.0 - plain), often / (1.0 - often)
    assert 2.5 < odds[1] / odds[0] < 6.0


def test_oversampling__keeps_more_states_in_which_the_student_errs() -> None:
    student = _student(8, highest=True)

    def wrong(decisions: Decisions) -> float:
        preferred = np.where(decisions.mask, student.biases[0], -np.inf).argmax(axis=1)
        return float(np.mean(~decisions.feasible[np.arange(len(preferred)), preferred]))

    plain, often = (
        wrong(_collected(PAPER, decisions=1200, student=student, oversampling=weight))
        for weight in (1.0, 4.0)
    )
    assert 0.01 < plain < 0.5
    odds = plain / (1.0 - plain), often / (1.0 - often)
    assert 2.5 < odds[1] / odds[0] < 6.0


def test_collect__covers_all_phases_that_leave_a_choice() -> None:
    found = _collected(PAPER, decisions=900)
    assert set(found.states.phase.tolist()) == set(range(1, 8))
