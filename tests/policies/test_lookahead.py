"""The planner: it follows its plan, replans only when disturbed, and is never worse than (21)."""

import math

import numpy as np
import pytest

from snake_env.errors import InvalidInputError, UnknownNameError
from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.base import Policy
from snake_env.policies.lookahead import FAILURES, LookaheadPolicy
from snake_env.policies.registry import load_policy
from snake_env.policies.value import PhaseValue
from snake_env.sim.simulation import advance, predict
from snake_env.sim.tasks import random_suite
from snake_env.state import SnakeState
from tests.support.robots import (
    DEADLOCK,
    FIVE,
    HARDWARE,
    NARROW,
    PAPER,
    random_state,
    start_of,
    straight_state,
)


def _planner(params: SnakeParams = PAPER, **options: float) -> LookaheadPolicy:
    chosen = {"width": 6, "deadline_ms": math.inf} | options
    return LookaheadPolicy(params, value=PhaseValue(params), **chosen)  # type: ignore[arg-type]


def _episode(
    policy: Policy, state: SnakeState, params: SnakeParams, horizon: int = 100
) -> tuple[list[int], bool]:
    """The modes that a policy chooses, up to the target, a violation or the horizon; success."""
    policy.reset(0)
    modes: list[int] = []
    while not state.done and len(modes) < horizon:
        modes.append(policy.select_mode(state))
        state, prediction = advance(state, modes[-1], params)
        if not prediction.feasible[0]:
            break
    return modes, state.done


def test_lookahead__is_never_worse_than_21() -> None:
    shorter = 0
    for task in range(12):
        analytic, succeeds = _episode(load_policy("analytic"), start_of(task), PAPER)
        modes, success = _episode(_planner(), start_of(task), PAPER)
        assert success >= succeeds
        if succeeds:
            assert len(modes) <= len(analytic)
            shorter += len(modes) < len(analytic)
    assert shorter >= 8


@pytest.mark.parametrize("params", [FIVE, NARROW, HARDWARE, SnakeParams(n_joints=9)])
def test_lookahead__is_never_worse_than_21_on_other_robots(params: SnakeParams) -> None:
    successes = 0
    for seed in range(4):
        phi0, target = np.random.default_rng(seed).uniform(-0.5, 0.5, (2, params.n_joints))
        start = SnakeState.initial(phi0, target, params)
        analytic, succeeds = _episode(load_policy("analytic", params), start, params, 30)
        modes, success = _episode(_planner(params, width=4), start, params, 30)
        assert all(mode < len(mode_table(params.n_joints)) for mode in modes)
        assert success >= succeeds
        assert not succeeds or len(modes) <= len(analytic)
        successes += success
    assert successes >= 2


def test_lookahead__searches_once_and_then_follows_its_plan() -> None:
    for task in range(3):
        policy, state = _planner(), start_of(task)
        assert policy.rollouts == 0
        modes = [policy.select_mode(state)]
        spent = policy.rollouts
        assert spent > 99
        while not state.done:
            state, prediction = advance(state, modes[-1], PAPER)
            assert prediction.feasible[0]
            if not state.done:
                modes.append(policy.select_mode(state))
        assert policy.rollouts == spent
        policy.reset()
        assert policy.rollouts == spent  # counted over all episodes
        policy.select_mode(start_of(task))
        assert policy.rollouts == 2 * spent


def _slipped(state: SnakeState) -> SnakeState:
    return state.replace(w=state.w + np.array([0.01, -0.01, 0.02]))


def _nudged(state: SnakeState) -> SnakeState:
    return state.replace(phi=state.phi + 1e-9)


def _redirected(state: SnakeState) -> SnakeState:
    return state.replace(target=state.target + 1e-3 * np.sign(-state.target))


@pytest.mark.parametrize("disturb", [_slipped, _nudged, _redirected])
def test_lookahead__replans_when_the_robot_is_elsewhere(disturb) -> None:
    policy, state = _planner(), start_of(0)
    searches = []
    for interval in range(100):
        if interval == 4:
            state = disturb(state)
        before = policy.rollouts
        mode = policy.select_mode(state)
        searches.append(policy.rollouts > before)
        state, prediction = advance(state, mode, PAPER)
        assert prediction.feasible[0]
        if state.done:
            break
    assert state.done
    assert [interval for interval, searched in enumerate(searches) if searched] == [0, 4]


def test_lookahead__does_not_mind_the_time_that_has_passed() -> None:
    policy, state = _planner(), start_of(0)
    mode = policy.select_mode(state)
    spent = policy.rollouts
    state, _ = advance(state, mode, PAPER)
    policy.select_mode(state.replace(elapsed=6.0, last_mode=5))
    assert policy.rollouts == spent


def test_lookahead__plans_anew_in_another_episode() -> None:
    policy, fresh = _planner(), _planner()
    state, _ = advance(start_of(0), policy.select_mode(start_of(0)), PAPER)
    spent = policy.rollouts
    policy.reset()
    policy.select_mode(state)
    assert policy.rollouts > spent  # although the old plan leads through this state
    policy.reset()
    assert policy.select_mode(start_of(1)) == fresh.select_mode(start_of(1))
    assert policy.select_mode(start_of(2)) == _planner().select_mode(start_of(2))  # even without


def test_lookahead__is_deterministic_without_a_deadline() -> None:
    params = NARROW.replace(horizon=25)
    start = random_suite(2, 3, params).initial(1, params)  # needs random numbers to find a plan

    def play(seed: int | None) -> tuple[list[int], int]:
        policy, state, modes = _planner(params, width=8), start, []
        policy.reset(seed)
        while not state.done and len(modes) < 25:
            modes.append(policy.select_mode(state))
            state, _ = advance(state, modes[-1], params)
        assert state.done
        return modes, policy.rollouts

    assert play(0) == play(0) == play(None)
    assert play(1) != play(0)


def test_lookahead__does_not_search_in_vain_again() -> None:
    policy = _planner(NARROW)

    def spent(state: SnakeState) -> int:
        before = policy.rollouts
        policy.select_mode(state)
        return policy.rollouts - before

    def moved(by: float) -> SnakeState:
        return DEADLOCK.replace(phi=DEADLOCK.phi - np.eye(8)[4] * by)

    first = spent(DEADLOCK)
    assert first > 2
    assert [spent(DEADLOCK), spent(DEADLOCK)] == [2, 2]  # (21) alone: the phase allows two modes
    searched = [spent(moved(0.002 * k)) > 2 for k in range(1, FAILURES + 2)]
    assert searched == [True] * (FAILURES - 1) + [False] * 2  # given up
    policy.reset()
    assert spent(DEADLOCK) == first


def test_lookahead__does_what_21_does_where_nothing_works() -> None:
    analytic = load_policy("analytic", NARROW)
    assert _planner(NARROW).select_mode(DEADLOCK) == analytic.select_mode(DEADLOCK)


@pytest.mark.parametrize("params", [PAPER, NARROW])
def test_lookahead__always_has_an_answer_in_time(params: SnakeParams) -> None:
    for deadline_ms in (1e-9, 1.0):
        policy = _planner(params, width=64, deadline_ms=deadline_ms)
        for seed in range(40):
            state = random_state(seed, params, 1 + seed % 8)
            policy.reset()
            mode = policy.select_mode(state)
            assert type(mode) is int
            assert mode_table(8).mask(state.phase)[mode]
            modes = mode_table(8).valid(state.phase)
            feasible = predict(state, modes, params).feasible
            assert predict(state, [mode], params).feasible[0] == feasible.any()


def test_lookahead__without_time_is_21() -> None:
    analytic, _ = _episode(load_policy("analytic"), start_of(0), PAPER)
    policy = _planner(deadline_ms=1e-9)
    assert _episode(policy, start_of(0), PAPER) == (analytic, True)


def test_lookahead__refuses_a_robot_that_has_arrived() -> None:
    arrived = straight_state().replace(phase=9)
    for name in ("analytic", "value", "lookahead"):
        with pytest.raises(InvalidInputError, match=r"^state\.phase = 9"):
            load_policy(name).select_mode(arrived)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("width", value) for value in (0, -3, 1.5, True, None, math.inf)),
        *(("depth", value) for value in (0, -1, 2.0, False)),
        *(("deadline_ms", value) for value in (0, 0.0, -1, math.nan, -math.inf, "1", None)),
    ],
)
def test_bad_option__is_refused(name: str, value: float) -> None:
    with pytest.raises(InvalidInputError, match=rf"^{name} = {value!r}: expected a positive"):
        LookaheadPolicy(PAPER, **{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "width", "depth", "deadline_ms"),
    [
        ("lookahead", 64, None, 1000.0),
        ("lookahead:width=4,deadline_ms=inf", 4, None, math.inf),
        ("lookahead:depth=3", 64, 3, 1000.0),
        ("lookahead:deadline_ms=2.5,depth=1,width=7", 7, 1, 2.5),
    ],
)
def test_option_string__is_read(
    text: str, width: int, depth: int | None, deadline_ms: float
) -> None:
    policy = load_policy(text, NARROW)
    assert isinstance(policy, LookaheadPolicy)
    assert policy.params is NARROW
    assert (policy.width, policy.depth, policy.deadline_ms) == (width, depth, deadline_ms)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lookahead:widht=4", r"^unknown option of lookahead 'widht': did you mean 'width'\?"),
        (
            "lookahead:",
            r"^unknown option of lookahead '': known: deadline_ms, depth, transfer, width$",
        ),
        ("lookahead:width=4,", r"^unknown option of lookahead ''"),
        ("lookahead:params=4", r"^unknown option of lookahead 'params'"),
        ("lookahead:value=4", r"^unknown option of lookahead 'value'"),
        ("analytic:candidates=4", r"^unknown option of analytic 'candidates'"),
        ("lookahaed:width=4", r"^unknown policy 'lookahaed': did you mean 'lookahead'\?"),
    ],
)
def test_option_string__with_an_unknown_name_gets_a_suggestion(text: str, message: str) -> None:
    with pytest.raises(UnknownNameError, match=message):
        load_policy(text)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("width=many", r"^lookahead:width = 'many': expected a number$"),
        ("width", r"^lookahead:width = '': expected a number$"),
        ("width=1=2", r"^lookahead:width = '1=2': expected a number$"),
        ("width=\u00b2", r"^lookahead:width = .*: expected a number$"),
        ("width=1.5", r"^width = 1\.5: expected a positive integer$"),
        ("width=0", r"^width = 0: expected a positive integer$"),
        ("width=inf", r"^width = inf: expected a positive integer$"),
        ("depth=-1", r"^depth = -1: expected a positive integer$"),
        ("deadline_ms=0", r"^deadline_ms = 0: expected a positive number, or inf$"),
        ("deadline_ms=nan", r"^deadline_ms = nan: expected a positive number, or inf$"),
        ("width=4,deadline_ms=-1", r"^deadline_ms = -1: expected a positive number, or inf$"),
    ],
)
def test_option_string__with_a_bad_value_is_refused(options: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        load_policy(f"lookahead:{options}")
