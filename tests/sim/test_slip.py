"""Slip of the wheels (section VI) in evaluations: what is drawn, and that replays repeat it."""

import dataclasses

import numpy as np
import pytest

from evaluate.replay import replay
from snake_env.sim.simulation import advance
from snake_env.sim.slip import NO_SLIP, SlipProcess
from snake_env.sim.tasks import random_suite
from tests.support.evaluations import evaluated
from tests.support.robots import PAPER, row_of, sim_1_episode

SLIP = (0.004, 0.02)
SUITE = random_suite(6, 8, PAPER)


def test_slip_process__moves_the_head_alone_by_normal_amounts() -> None:
    states, modes, _ = sim_1_episode()
    after, prediction = advance(states[0], modes[0], PAPER)
    slips = []
    for task in range(2000):
        there, same = SlipProcess(SLIP, task, PAPER).advance(states[0], modes[0])
        slips.append(there.w - after.w)
        if task < 3:
            for field in dataclasses.fields(after):
                if field.name != "w":
                    a, b = getattr(there, field.name), getattr(after, field.name)
                    np.testing.assert_array_equal(a, b)
            np.testing.assert_array_equal(same.cost, prediction.cost)
    scale = np.array([SLIP[0], SLIP[0], SLIP[1]])
    scaled = np.array(slips) / scale
    np.testing.assert_allclose(scaled.mean(axis=0), 0.0, atol=4 / np.sqrt(2000))
    np.testing.assert_allclose(scaled.std(axis=0), 1.0, atol=4 / np.sqrt(4000))
    assert abs(np.corrcoef(scaled.T) - np.eye(3)).max() < 4 / np.sqrt(2000)


def test_slips__follow_each_other_and_depend_on_the_task_alone() -> None:
    states, modes, _ = sim_1_episode()

    def slips_of(task: int, some_modes: list[int]) -> list[np.ndarray]:
        process, state, found = SlipProcess(SLIP, task, PAPER), states[0], []
        for mode in some_modes:
            there, _ = process.advance(state, mode)
            found.append(there.w - advance(state, mode, PAPER)[0].w)
            state = there
        return found

    one, again, other = (
        slips_of(3, modes[:3]),
        slips_of(3, [modes[1]] * 3),
        slips_of(4, modes[:3]),
    )
    np.testing.assert_allclose(one, again, atol=1e-15)  # whatever the policy chooses
    assert min(abs(np.subtract(one, other)).max(axis=1)) > 1e-4
    assert abs(one[0] - one[1]).max() > 1e-4


def test_slip_process__without_slip_is_the_model() -> None:
    states, modes, _ = sim_1_episode()
    process = SlipProcess(NO_SLIP, 1, PAPER)
    for state, mode in zip(states, modes, strict=False):
        np.testing.assert_array_equal(
            process.advance(state, mode)[0].w, advance(state, mode, PAPER)[0].w
        )


@pytest.mark.parametrize("policy", ["analytic", "imitate+shield"])
def test_replay__ends_where_the_episode_did(policy: str) -> None:
    rows, without = evaluated(policy, SUITE, slip=SLIP), evaluated(policy, SUITE)
    for row, still in zip(rows, without, strict=True):
        state = SUITE.initial(row["task"], PAPER)
        played = replay(row, state, PAPER)
        heads = np.array([s.w for s in played.states]) - PAPER.w_d
        assert played.states[-1].elapsed == pytest.approx(row["time_s"])
        assert row["head_error_m"] == pytest.approx(np.hypot(*heads.T[:2]).max(), rel=1e-12)
        assert row["head_error_rad"] == pytest.approx(abs(heads[:, 2]).max(), rel=1e-12)
        assert row["head_error_m"] > 1e-3
        assert still["head_error_m"] < 1e-9
        assert (row["slip_m"], row["slip_rad"]) == SLIP
        unmoved = replay(row_of(played.modes[:1]), state, PAPER)
        assert abs(unmoved.states[-1].w - played.states[1].w).max() > 1e-4
