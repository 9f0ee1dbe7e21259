"""DQN that stays close to its student: against SB3's own update, and term by term."""

from __future__ import annotations

import copy
import dataclasses
import io

import numpy as np
import pytest
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import CallbackList
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import set_random_seed

from agents.dqn import AnchoredDQN, DQNLearner, Settings
from snake_env.networks.model_file import REWARD_PER_LOGIT
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.sb3 import SnakeVecEnv
from tests.support.models import model_of, same_network

SETTINGS = Settings(
    hidden=(12,), num_envs=4, buffer_size=400, learning_starts=64, n_steps=8, target_update=96,
    batch_size=16, gradient_steps=3, anchor=0.0, ema_rate=0.3,
)  # fmt: skip

FLOOR = -3.0  # success 1, less 0.1 for each of 40 intervals


def _learner(**changes: object) -> DQNLearner:
    env = SnakeVecEnv(4, mask_in_observation=True)
    return DQNLearner(dataclasses.replace(SETTINGS, **changes), env, seed=1, device="cpu")  # type: ignore[arg-type]


def _learnt(decisions: int = 160, **changes: object) -> DQNLearner:
    learner = _learner(**changes)
    if learner.model.weight:
        learner.begin(_student())
    learner.learn(decisions, 7, CallbackList([]), lambda *_: None)
    return learner


def _student() -> Network:
    return model_of(3).network


def _weights(model: DQN) -> list[np.ndarray]:
    return [part.detach().numpy().copy() for part in model.q_net.parameters()]


def _same(one: DQN, other: DQN) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(_weights(one), _weights(other), strict=True))


def _seeded_update(model: DQN, update: object) -> None:
    set_random_seed(5)
    model.set_logger(Logger(folder=None, output_formats=[]))
    update(model, 4, 16)  # type: ignore[operator]


def _two_above_the_floor() -> tuple[AnchoredDQN, AnchoredDQN]:
    """The same learner twice; no reward in its buffer is as bad as a failure."""
    ours, theirs = _learnt().model, _learnt().model
    for model in (ours, theirs):
        assert model.replay_buffer is not None
        model.replay_buffer.rewards[:] = np.maximum(model.replay_buffer.rewards, -0.1)
        model.max_grad_norm = 0.02  # gradients are clipped
        with torch.no_grad():
            batch = model.replay_buffer.sample(100)
            after = model.q_net_target(batch.next_observations).max(dim=1).values
        assert after.min().item() > FLOOR + 0.2
    return ours, theirs


def test_train__is_sb3s_where_nothing_fails_and_there_is_no_anchor() -> None:
    ours, theirs = _two_above_the_floor()
    before = _weights(ours)
    _seeded_update(ours, AnchoredDQN.train)
    _seeded_update(theirs, DQN.train)
    assert _same(ours, theirs)
    assert not np.array_equal(before[0], _weights(ours)[0])
    assert ours._n_updates == theirs._n_updates
    one, other = (model.logger.name_to_value["train/loss"] for model in (ours, theirs))
    assert one == pytest.approx(other)


@pytest.mark.parametrize("difference", ["floor", "anchor"])
def test_train__is_not_sb3s_otherwise(difference: str) -> None:
    ours, theirs = _two_above_the_floor()
    if difference == "floor":
        for model in (ours, theirs):
            for net in (model.q_net, model.q_net_target):
                with torch.no_grad():
                    net.q_net[-1].bias.fill_(FLOOR - 0.5)  # not far: there slopes are 1
    else:
        anchor = copy.deepcopy(theirs.q_net)
        with torch.no_grad():
            for part in anchor.parameters():
                part += 0.1
        ours.anchor, ours.weight = anchor, 1.0
    _seeded_update(ours, AnchoredDQN.train)
    _seeded_update(theirs, DQN.train)
    assert not _same(ours, theirs)


def test_targets__are_not_below_the_floor() -> None:
    """With rewards of -30 everywhere the values come down to the floor and stay there."""
    model = _learnt(learning_rate=0.01).model
    assert model.floor == FLOOR
    assert model.replay_buffer is not None
    model.replay_buffer.rewards[:] = -30.0
    _seeded_update(model, lambda m, *_: m.train(400, 16))
    batch = model.replay_buffer.sample(64)
    with torch.no_grad():
        values = model.q_net(batch.observations).gather(1, batch.actions.long())
    assert float(values.mean()) == pytest.approx(FLOOR, abs=0.3)


def test_loss__is_the_bellman_error_and_the_distance_from_the_student() -> None:
    model = _learnt(anchor=2.5).model
    assert model.replay_buffer is not None
    assert model.anchor is not None
    model.replay_buffer.rewards[::2] = -30.0  # so that the floor counts in some
    model.replay_buffer.dones[::3] = 1.0
    with torch.no_grad():  # away from the student, so that there is a distance
        for part in model.q_net.parameters():
            part += 0.02
    twin = copy.deepcopy(model)
    set_random_seed(5)
    batch = model.replay_buffer.sample(16)
    values, known = model.q_net(batch.observations), model.anchor(batch.observations)
    error = distance = torch.tensor(0.0)
    n_open, floored = 0, set()
    for k in range(16):
        mask = batch.observations["action_mask"][k] > 0
        after = model.q_net_target(batch.next_observations)[k].max()
        target = batch.rewards[k, 0] + (1 - batch.dones[k, 0]) * model.gamma * after
        floored.add(target.item() < FLOOR)
        gap = values[k, int(batch.actions[k, 0])] - max(target.item(), FLOOR)
        error = error + (0.5 * gap**2 if abs(gap.item()) < 1 else abs(gap) - 0.5) / 16
        distance = distance + ((values[k] - known[k])[mask] ** 2).sum()
        n_open += int(mask.sum())
    loss = error + 2.5 * distance / n_open
    assert distance.item() > 0.0
    assert floored == {True, False}
    gradient = torch.autograd.grad(loss, list(model.q_net.parameters()))
    size = torch.sqrt(sum((part**2).sum() for part in gradient))
    wanted = [part / max(1.0, size.item() / twin.max_grad_norm) for part in gradient]
    _seeded_update(twin, lambda m, *_: m.train(1, 16))
    for part, expected in zip(twin.q_net.parameters(), wanted, strict=True):
        assert part.grad is not None
        torch.testing.assert_close(part.grad, expected, rtol=1e-3, atol=1e-6)


def test_anchor__holds_the_values_near_the_students() -> None:
    def away(anchor: float) -> float:
        model = _learnt(600, anchor=anchor, learning_rate=0.003).model
        assert model.replay_buffer is not None
        assert model.anchor is not None
        batch = model.replay_buffer.sample(100)
        mask = batch.observations["action_mask"] > 0
        with torch.no_grad():
            gap = model.q_net(batch.observations) - model.anchor(batch.observations)
        return float(gap[mask].square().mean())

    assert away(1000.0) < 0.2 * away(1e-6)


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_network__is_the_running_mean_of_the_action_values_weights(share: float) -> None:
    learner = _learner(ema_rate=share)
    layer, seen = learner.model.q_net.q_net[-1], []

    def note(decisions: int, figures: dict[str, float]) -> None:
        assert {"loss", "action_value"} <= figures.keys()
        seen.append((decisions, layer.weight.detach().numpy().T.astype(np.float64).copy()))

    learner.learn(224, 0, CallbackList([]), note)
    assert [decisions for decisions, _ in seen] == [96, 128, 160, 192, 224]  # 64 are not enough
    expected = seen[0][1]
    for _, newest in seen[1:]:
        expected = expected + share * (newest - expected)
    made = REWARD_PER_LOGIT * learner.network().weights[-1]
    np.testing.assert_allclose(made, expected, rtol=1e-5, atol=1e-6)
    assert np.allclose(made, seen[-1][1], rtol=1e-5, atol=1e-6) == (share == 1.0)


def test_begin__without_a_weight_has_no_anchor() -> None:
    learner = _learner(anchor=0.0)
    learner.begin(_student())
    assert learner.model.anchor is None
    assert learner.saved()["anchor"] is None
    assert learner.critic(SnakeParams()) is None  # its own action values


def test_anchor__stays_what_it_is_while_the_values_are_learned() -> None:
    learner = _learner(anchor=0.1, learning_rate=0.01, target_update=64)
    learner.begin(_student())
    learner.learn(320, 7, CallbackList([]), lambda *_: None)
    model, first = learner.model, _student().weights[0]
    assert model.anchor is not None
    anchor, values, target = (
        next(net.parameters()).detach().numpy().T
        for net in (model.anchor, model.q_net, model.q_net_target)
    )
    np.testing.assert_array_equal(anchor, first)
    assert not np.allclose(values, first, atol=1e-3)
    assert not np.allclose(target, first, atol=1e-3)


@pytest.mark.parametrize("begun", [160, 480], ids=["filling", "full"])
@pytest.mark.parametrize("anchor", [0.0, 3.0])
def test_restored__it_goes_on_as_if_nothing_had_happened(anchor: float, begun: int) -> None:
    through, first = _learnt(begun, anchor=anchor), _learnt(begun, anchor=anchor)
    assert first.saved()["full"] == (begun > SETTINGS.buffer_size)
    file = io.BytesIO()
    torch.save(first.saved(), file)
    file.seek(0)
    state = torch.load(file, weights_only=True)
    second = _learner(anchor=anchor)
    second.restore(state)
    for learner in (through, second):
        learner.learn(begun + 160, 8, CallbackList([]), lambda *_: None)
    assert _same(through.model, second.model)
    assert through.model.num_timesteps == second.model.num_timesteps == begun + 160
    assert (through.model.anchor is None) == (second.model.anchor is None) == (anchor == 0.0)
    told, again = (each.model.policy.state_dict() for each in (through, second))
    assert all(torch.equal(told[name], again[name]) for name in told)
    assert same_network(through.network(), second.network())
    assert not _same(first.model, second.model)


def test_restored_learner__explores_as_one_that_went_on() -> None:
    """SB3 sets the rate of exploration after its first step only."""
    changes = {"exploration": 0.9, "exploration_end": 0.8, "anchor": 0.0}
    learner = _learnt(**changes)
    other = _learner(**changes)
    other.restore(copy.deepcopy(learner.saved()))
    chosen = []
    for each in (learner, other):
        each.learn(256, 8, CallbackList([]), lambda *_: None)
        buffer = each.model.replay_buffer
        chosen.append(buffer.actions[: buffer.pos])
    assert len(chosen[0]) > 50
    assert np.array_equal(*chosen)
    assert _same(learner.model, other.model)
