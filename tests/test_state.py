"""States: how an episode begins, batches of states, and which shapes are refused."""

import math

import numpy as np
import pytest

from snake_env.errors import InvalidInputError
from snake_env.params import SnakeParams
from snake_env.sim.simulation import advance, joint_input, predict
from snake_env.state import SnakeState, StateBatch, checked_shape
from tests.support.robots import PAPER, random_state, same_state, straight_state

BENT = np.linspace(-0.4, 0.5, 8)
ZEROS = np.zeros(8)


def test_initial__is_phase_1_with_the_head_where_it_should_be() -> None:
    state = SnakeState.initial(BENT, -BENT, PAPER)
    assert state.w.tolist() == [0.0, 0.0, math.pi]
    assert (state.phi.tolist(), state.target.tolist()) == (BENT.tolist(), (-BENT).tolist())
    assert (state.phase, state.phase_time, state.elapsed) == (1, 0.0, 0.0)
    assert state.ref_start == BENT[0]
    assert not state.done


def test_initial__copies_its_arguments() -> None:
    phi0, target = BENT.copy(), ZEROS.copy()
    state = SnakeState.initial(phi0, target, PAPER)
    phi0[:], target[:] = 9.0, 9.0
    assert state.phi.tolist() == BENT.tolist()
    assert state.target.tolist() == ZEROS.tolist()


def test_initial__takes_lists_and_integers() -> None:
    state = SnakeState.initial([0] * 8, [0.1] * 8, PAPER)
    assert state.phi.dtype == state.target.dtype == np.float64


@pytest.mark.parametrize("n", range(5, 17))
def test_initial__fits_any_number_of_joints(n: int) -> None:
    state = SnakeState.initial([0.0] * n, [0.1] * n, SnakeParams(n_joints=n))
    assert state.phi.shape == state.target.shape == (n,)


def test_done__is_the_phase_after_the_last() -> None:
    state = SnakeState.initial(ZEROS, ZEROS, PAPER)
    assert not state.replace(phase=8).done
    assert state.replace(phase=9).done


def test_shape__may_lie_on_the_limit_within_the_tolerance() -> None:
    for angle in (math.pi / 2, -math.pi / 2, math.pi / 2 + 0.9e-6):
        assert checked_shape("phi0", [angle] + [0.0] * 7, PAPER)[0] == angle


def _with(k: int, angle: float) -> list[float]:
    shape = ZEROS.tolist()
    shape[k] = angle
    return shape


@pytest.mark.parametrize("which", ["phi0", "target"])
@pytest.mark.parametrize(
    ("shape", "suffix", "reason"),
    [
        (_with(3, math.nan), "[3]", "finite"),
        (_with(7, -math.inf), "[7]", "finite"),
        (_with(0, 1.5708 + 1e-4), "[0]", "phi_limit"),
        (_with(5, -2.0), "[5]", "phi_limit"),
        (ZEROS[:7], ".shape", "(8,)"),
        (np.zeros(9), ".shape", "(8,)"),
        (np.zeros((1, 8)), ".shape", "(8,)"),
        (0.0, ".shape", "(8,)"),
        (None, ".shape", "(8,)"),
        (list("abcdefgh"), "", "8 joint angles"),
        ([[0.0], [0.0, 1.0]], "", "8 joint angles"),
        (["0"] * 8, "", "joint angles"),
        (ZEROS * 1j, "", "joint angles"),
        ([10**400] + [0] * 7, "", "joint angle"),
        (np.full(8, 1.5), "", "d_min = 0.028 m"),
    ],
)
def test_initial__refuses_bad_shapes(which: str, shape: object, suffix: str, reason: str) -> None:
    shapes = {"phi0": ZEROS, "target": ZEROS, which: shape}
    with pytest.raises(InvalidInputError) as caught:
        SnakeState.initial(**shapes, params=PAPER)
    assert caught.value.field.startswith(which + suffix)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_refusal__shows_the_value() -> None:
    with pytest.raises(InvalidInputError, match=r"phi0\[2\] = -1\.75: expected"):
        SnakeState.initial(_with(2, -1.75), ZEROS, PAPER)


def test_d_min__of_just_2_l_is_accepted_and_less_refused() -> None:
    def folded(angle: float) -> list[float]:
        return [0.0, 0.0, 0.0, angle, angle, 0.0, 0.0, 0.0]

    assert checked_shape("phi0", folded(math.pi / 2 - 1e-3), PAPER).shape == (8,)
    with pytest.raises(InvalidInputError, match=r"at least 0\.182 m apart"):
        checked_shape("phi0", folded(math.pi / 2 + 1e-3), PAPER.replace(phi_limit=1.7))


def test_batch__gives_its_states_back() -> None:
    states = [random_state(seed) for seed in range(5)]
    batch = StateBatch.stack(states)
    assert len(batch) == 5
    assert all(same_state(batch[k], state) for k, state in enumerate(states))


def test_batch__takes_states_in_order_and_more_than_once() -> None:
    states = [random_state(seed) for seed in range(4)]
    taken = StateBatch.stack(states).take([3, 0, 3])
    assert all(same_state(taken[k], states[i]) for k, i in enumerate((3, 0, 3)))


def test_batch__shares_no_memory_with_its_states() -> None:
    state = random_state(0)
    batch = StateBatch.stack([state])
    before, out = state.phi.copy(), batch[0]
    for array in (batch.phi, batch.w):
        assert not np.shares_memory(array, state.phi)
        assert not np.shares_memory(array, out.phi)
        assert not np.shares_memory(array, out.w)
    assert state.phi.tolist() == out.phi.tolist() == before.tolist()
    assert out.w.tolist() == state.w.tolist()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("phi", np.zeros(7)), ("target", np.zeros(7)), ("w", np.zeros(2))),
        *(("phase", 0), ("phase", 10), ("phase", 1.5), ("phase", math.nan)),
    ],
)
def test_bad_state__is_refused_by_name(field: str, value: object) -> None:
    state = straight_state().replace(**{field: value})
    for run in (
        lambda: predict(state, [0], PAPER),
        lambda: advance(state, 0, PAPER),
        lambda: joint_input(state, 0, 0.0, PAPER),
    ):
        with pytest.raises(InvalidInputError) as caught:
            run()
        assert caught.value.field.removeprefix("state.").startswith(field)


def test_state_of_another_robot__is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"^state\.phi = 8: expected n_joints = 6"):
        predict(straight_state(), [0], PAPER.replace(n_joints=6))
