"""``+critic``, written down once more."""

from typing import NamedTuple

import numpy as np

from snake_env.modes import mode_table
from snake_env.params import SnakeParams
from snake_env.policies.value import ValueFunction
from snake_env.sim.simulation import advance, predict
from snake_env.state import SnakeState, StateBatch


class Told(NamedTuple):
    """A decision, what it took, and by which of the rules it was made."""

    mode: int
    simulated: int
    rule: str


def plus_critic(
    state: SnakeState, ranked: np.ndarray, value: ValueFunction, params: SnakeParams, k: int
) -> Told:
    """Simulates one mode at a time: the preferred modes, the next ones, the others; (21) in the end.

    Nothing where the phase allows one mode only.

    Args:
        state: The robot at t_k.
        ranked: The modes that may be chosen, the preferred ones first.
        value: Ranks the ends.
        params: The constants.
        k: Favourites at a time.
    """
    possible = mode_table(params.n_joints).valid(state.phase).tolist()
    if len(possible) == 1:
        return Told(possible[0], 0, "no choice")
    simulated, standing = 0, []
    portions = {
        "preferred modes": ranked[:k],
        "next preferred modes": ranked[k : 2 * k],
        "others": ranked[2 * k :],
    }
    for rule, portion in portions.items():
        leading, creeping = [], []
        for place, mode in enumerate(portion.tolist()):
            after, prediction = advance(state, mode, params)
            simulated += 1
            if not prediction.feasible[0] or prediction.d_min[0] < params.d_touch:
                continue
            worth = float(value(StateBatch.stack([after]))[0])
            creeps = np.abs(after.phi - state.phi).max() < np.float32(0.05)
            (creeping if creeps else leading).append((worth, place, mode))
        if leading:
            return Told(min(leading)[2], simulated, rule)
        standing = standing or creeping
    if standing:
        return Told(min(standing)[2], simulated, "leads nowhere")
    lasting = []
    for mode in possible:
        prediction = predict(state, [mode], params)
        simulated += 1
        lasting.append((not prediction.feasible[0], prediction.j[0], -prediction.duration[0], mode))
    return Told(min(lasting)[3], simulated, "last resort")
