"""The robot's mirror image, and networks that do not depend on which image they are given."""

import numpy as np
import pytest

from snake_env.modes import mode_table
from snake_env.networks.symmetry import (
    CanonicalNetwork,
    SymmetricNetwork,
    canonical_sign_index,
    mirror,
)
from snake_env.params import SnakeParams
from snake_env.sim.observation import observation_rows, observation_size, observe
from snake_env.sim.simulation import advance
from snake_env.state import SnakeState, StateBatch
from tests.support.models import random_network
from tests.support.robots import FIVE, NARROW, PAPER, mirrored, random_state


def _moved(seed: int, params: SnakeParams) -> SnakeState:
    """A state with a last mode and a last turn."""
    state = random_state(seed, params, 1 + seed % params.n_joints, head_error=0.05)
    valid = mode_table(params.n_joints).valid(state.phase)
    return advance(state, int(valid[seed % len(valid)]), params)[0]


@pytest.mark.parametrize(
    "params", [FIVE, PAPER, SnakeParams(n_joints=9), NARROW], ids=["5", "8", "9", "narrow"]
)
def test_mirror__is_the_observation_of_the_mirrored_robot(params: SnakeParams) -> None:
    states = [_moved(seed, params) for seed in range(30)]
    images = [mirrored(state, params) for state in states]
    order, sign = mirror(params.n_joints)
    one = observe(StateBatch.stack(states), params)
    other = observe(StateBatch.stack(images), params)
    assert np.abs(one[:, order] * sign - other).max() < 1e-6
    assert np.abs(one - other).max(axis=0).astype(bool).sum() > len(sign) / 2


@pytest.mark.parametrize("n_joints", [5, 8, 9, 16])
def test_mirror__twice_is_nothing(n_joints: int) -> None:
    order, sign = mirror(n_joints)
    x = np.random.default_rng(0).normal(size=(3, observation_size(n_joints))).astype(np.float32)
    assert order.shape == sign.shape == x.shape[1:]
    once = x[:, order] * sign
    assert not np.array_equal(once, x)
    assert np.array_equal(once[:, order] * sign, x)


@pytest.mark.parametrize("hidden", [[], [11], [11, 7]])
@pytest.mark.parametrize("n_joints", [5, 8])
def test_symmetric_network__is_the_mean_of_what_both_images_get(
    n_joints: int, hidden: list[int]
) -> None:
    sizes = [observation_size(n_joints), *hidden, 4]
    network = random_network(sizes, len(hidden), 0.2)
    order, sign = mirror(n_joints)
    x = np.random.default_rng(7).uniform(-1.0, 1.0, (6, sizes[0])).astype(np.float32)
    symmetric = SymmetricNetwork(network, n_joints)
    mean = 0.5 * (network(x) + network(x[:, order] * sign))
    np.testing.assert_allclose(symmetric(x), mean, atol=1e-5)
    np.testing.assert_allclose(symmetric(x), symmetric(x[:, order] * sign), atol=1e-5)
    np.testing.assert_allclose(symmetric(x[:1]), mean[:1], atol=1e-5)


@pytest.mark.parametrize("n_joints", [5, 8])
def test_canonical_network__answers_for_the_image_whose_last_target_is_not_negative(
    n_joints: int,
) -> None:
    sizes = [observation_size(n_joints), 7, 4]
    network = random_network(sizes, 0, 0.2)
    order, sign = mirror(n_joints)
    image = CanonicalNetwork(network, n_joints)
    last = [name for name, size in observation_rows(n_joints) for _ in range(size)]
    last_target = len(last) - 1 - last[::-1].index("target")
    assert canonical_sign_index(sizes[0]) == last_target
    x = np.random.default_rng(7).uniform(-1.0, 1.0, (8, sizes[0])).astype(np.float32)
    x[0, last_target] = 0.0
    images = x[:, order] * sign
    left = x[:, last_target] >= 0.0
    assert 2 <= left.sum() <= 6
    wanted = network(np.where(left[:, None], x, images))
    assert not np.allclose(wanted, network(x), atol=1e-2)
    np.testing.assert_allclose(image(x), wanted, atol=1e-5)
    for same_side in (x[left][1:], x[~left]):  # as in one episode; at 0 it is both images
        np.testing.assert_allclose(image(same_side), image(same_side[:, order] * sign), atol=1e-5)
    np.testing.assert_allclose(image(x[left]), wanted[left], atol=1e-5)
    np.testing.assert_allclose(image(x[~left]), wanted[~left], atol=1e-5)
    assert image(x[:0]).shape == (0, 4)
