"""Value functions: phases left, and what a network adds."""

import numpy as np
import pytest

from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Model
from snake_env.networks.network import Network
from snake_env.networks.symmetry import CanonicalNetwork, mirror
from snake_env.params import SnakeParams
from snake_env.policies.value import ActionValue, NetworkValue, PhaseValue, load_value
from snake_env.sim.masks import instant_mask
from snake_env.sim.observation import observation_size, observe
from snake_env.state import SnakeState, StateBatch
from tests.support.models import model_of, random_network
from tests.support.robots import PAPER, random_state, straight_state


def test_phase_value__counts_the_phases_left_and_this_ones_error() -> None:
    target = np.zeros(8)
    target[2] = 0.3
    state = straight_state().replace(target=target)
    states = StateBatch.stack([state.replace(phase=phase) for phase in range(1, 10)])
    share = 0.3 / np.pi  # of the widest that a joint can be off
    assert PhaseValue(PAPER)(states) == pytest.approx([7, 6, 5 + share, 4, 3, 2, 1, 0, 0])


def test_network_value__is_what_the_network_says_of_an_image_or_0_at_the_target() -> None:
    states = [random_state(seed) for seed in range(6)]
    batch = StateBatch.stack([*states, states[0].replace(phase=9)])
    network = random_network([99, 4, 1], 0)
    order, sign = mirror(8)
    seen = observe(batch, PAPER)
    of_state, of_image = (network(x)[:, 0] for x in (seen, seen[:, order] * sign))
    right = batch.target[:, -1] >= 0.0
    assert 1 <= right[:6].sum() <= 5
    wanted = {
        "canonical": np.where(right, of_state, of_image),
        "both": 0.5 * (of_state + of_image),
        "given": of_state,
    }
    for images, expected in wanted.items():
        model = Model("value", PAPER, network, images=images)  # type: ignore[arg-type]
        values = NetworkValue(model, PAPER)(batch)
        assert values.dtype == np.float64
        assert values[:6] == pytest.approx(expected[:6], abs=1e-5)
        assert values[6] == 0.0
        assert expected[6] != 0.0


def test_network_value__of_no_states_is_empty() -> None:
    values = NetworkValue(Model("value", PAPER, random_network([99, 4, 1], 0)), PAPER)
    assert values(StateBatch.stack([random_state(0)]).take([])).shape == (0,)


def test_network_value__refuses_policies_and_other_robots() -> None:
    policy = Model("policy", PAPER, random_network([99, 4, 99], 0))
    with pytest.raises(InvalidInputError, match=r"^model\.kind = 'policy': expected value$"):
        NetworkValue(policy, PAPER)
    with pytest.raises(InvalidInputError, match=r"^n_joints = 8: expected 5"):
        NetworkValue(
            Model("value", SnakeParams(n_joints=5), random_network([observation_size(5), 4, 1], 0)),
            PAPER,
        )


def _best_return(state: SnakeState, network: Network, params: SnakeParams) -> float:
    """The largest action value of the modes that are stable at t_k, from the canonical image."""
    order, sign = mirror(params.n_joints)
    (seen,) = observe(StateBatch.stack([state]), params)
    image = seen if state.target[-1] >= 0.0 else seen[order] * sign
    hidden = np.maximum(image @ network.weights[0] + network.biases[0], 0.0)
    returns = 0.03 * (hidden @ network.weights[1] + network.biases[1])
    return max(float(returns[mode]) for mode in np.flatnonzero(instant_mask(state, params)))


@pytest.mark.parametrize(
    "params", [PAPER, SnakeParams.preset("narrow"), SnakeParams(n_joints=6, l=0.1)]
)
def test_action_value__is_what_the_best_open_modes_return_is_in_intervals(
    params: SnakeParams,
) -> None:
    n = params.n_joints
    model = model_of(5, n)
    closed_is_best = 0
    states = [random_state(seed, params) for seed in range(40)]
    batch = StateBatch.stack([*states, states[0].replace(phase=n + 1)])
    intervals = ActionValue(Model("policy", params, model.network), params)(batch)
    assert intervals.shape == (41,)
    assert intervals[40] == 0.0
    for state, found in zip(states, intervals, strict=False):
        best = _best_return(state, model.network, params)
        # the reward: 1 for the target, -0.1 for each interval
        assert 1.0 - 0.1 * found == pytest.approx(best, abs=1e-5)
        everything = CanonicalNetwork(model.network, n)(observe(StateBatch.stack([state]), params))
        closed_is_best += 0.03 * everything.max() > best + 1e-3
    assert closed_is_best > 10  # what can't be chosen does not count


def test_action_value__of_no_states_is_empty() -> None:
    empty = StateBatch.stack([random_state(0)]).take([])
    assert ActionValue(model_of(0), PAPER)(empty).shape == (0,)


@pytest.mark.parametrize(
    "params",
    [PAPER, SnakeParams.preset("narrow"), SnakeParams(n_joints=5), SnakeParams(n_joints=6)],
)
def test_load_value__falls_as_the_target_comes_near(params: SnakeParams) -> None:
    value, n = load_value(params), params.n_joints
    means = [
        float(value(StateBatch.stack([random_state(k, params, phase) for k in range(200)])).mean())
        for phase in (1, n // 2, n)
    ]
    assert means[0] > means[1] > means[2] > 0.0
    assert value(StateBatch.stack([random_state(0, params, n).replace(phase=n + 1)])) == 0.0
