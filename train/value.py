"""``python -m train value``: the cost-to-go network, by policy iteration."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from rich.console import Console

from agents.checks import check_not_negative, check_positive, check_share
from agents.returns import Play, Returns, play
from agents.value import Fit, fit
from harness.engine import Engine
from harness.progress import progress, tracked
from harness.provenance import command
from harness.robot import Robot
from snake_env.errors import InvalidInputError
from snake_env.networks.model_file import Model, read_model, write_model
from snake_env.networks.network import Network
from snake_env.params import SnakeParams
from snake_env.sim.array_file import ArrayFileError, read_arrays
from snake_env.sim.observation import observation_size
from snake_env.sim.warm_up import warm_up
from train.ground import Ground
from train.initial_models import read_checked
from train.run import Run, RunFolder, part_seed

_LARGEST = 8 * 2**30  # bytes of an array of returns
_PART = 256  # episodes that a worker plays side by side


@dataclass(frozen=True)
class Options:
    """Learn the cost-to-go of a state in intervals: teacher, critic, and guide of the planner.

    Each generation plays random tasks by the present value, after some exploration, and fits the next
    one to the returns.
    """

    run: Run = field(default_factory=Run)
    robot: Robot = field(default_factory=Robot)
    engine: Engine = field(default_factory=Engine)
    ground: Ground = field(default_factory=Ground)
    fit: Fit = field(default_factory=Fit)
    init: Path | None = None
    """Model file that plays the first generation, and whose weights are trained further if it has the
    same hidden layers; {seed} is replaced by the run's seed. Default: the reward's potential plays."""
    generations: int = 20
    """Rounds of playing and fitting."""
    episodes: int = 8192
    """Episodes per generation, on random tasks."""
    trace_decay: float = 0.7
    """Lambda of TD(lambda), after the generations of --exact. Below 1 the targets bootstrap from the
    current value, which reduces their variance."""
    exact: int = 4
    """First generations, which are trained on full Monte Carlo returns."""
    window: int = 5
    """Generations whose returns the network is fitted to."""

    def check(self) -> SnakeParams:
        """The constants that the options ask for.

        Raises:
            SnakeEnvError: An option's value can't be used.
        """
        check_positive(self, "generations", "episodes", "window")
        check_share(self, "trace_decay")
        check_not_negative(self, "exact")
        self.fit.check()
        self.ground.check()
        self.engine.check()
        return self.robot.params()


def train(options: Options, console: Console) -> Path:
    """Runs all generations, or those that an interrupted run has left.

    A generation depends on the run's seed, its own number and the network before it only. So a run
    that was killed resumes in its generation, and ends with the same bytes.

    Returns:
        The model's file.
    """
    params = options.check()
    init = None if options.init is None else options.run.own(options.init)
    transfer = options.robot.transfer
    given = None if init is None else read_checked(init, params, "value", transfer=transfer)
    begun = None if given is None else given.network
    config = {
        **dataclasses.asdict(options.fit),
        "init": given and given.sha256,
        **{
            key: getattr(options, key)
            for key in ("generations", "episodes", "trace_decay", "exact", "window")
        },
        "slip": options.ground.slip,
        "seed": options.run.seed,
        "params": dataclasses.asdict(params),
    }
    with RunFolder(options.run, "value", options.robot, config) as folder:
        file = folder.path / "value.safetensors"
        rows = folder.rows("generation")
        finished = len(rows) >= options.generations
        sizes = [observation_size(params.n_joints), *options.fit.hidden, 1]
        network = begun if begun is not None and begun.sizes == sizes else None
        if rows:
            network = read_model(_kept(folder.path, len(rows) - 1)).network
        torch.set_num_threads(1)
        warm_up(params)
        for generation in range(len(rows), options.generations):
            label = f"generation {generation + 1} of {options.generations}"
            player = begun if network is None else network
            played = _play(options, generation, player, params, label, console)
            np.savez(
                folder.path / f"returns-{generation}.npz",
                observations=np.concatenate([returns.observations for returns in played]),
                intervals=np.concatenate([returns.intervals for returns in played]),
            )
            first = max(0, generation + 1 - options.window)
            window = [_returns(folder.path, k) for k in range(first, generation + 1)]
            network, error = fit(
                network,
                np.concatenate([observations for observations, _ in window]),
                np.concatenate([intervals for _, intervals in window]),
                options.fit,
                options.fit.learning_rate * (1.0 - 0.95 * generation / options.generations),
                params.n_joints,
                seed=part_seed(options.run.seed, generation),
                track=functools.partial(tracked, console, label, "batches"),
            )
            row = {
                "generation": generation + 1,
                **_greedy(played, params),
                "fit_error": round(error, 4),
            }
            made = {"command": command(), "config": config, "generation": generation + 1}
            write_model(_kept(folder.path, generation), Model("value", params, network, made))
            rows.append({key: str(value) for key, value in row.items()})
            folder.write_rows(rows)
            for stale in (
                folder.path / f"returns-{first - 1}.npz",
                _kept(folder.path, generation - 1),
            ):
                stale.unlink(missing_ok=True)
            console.print(
                f"{label}: {row['success']:.1%} solved by greedy play, {row['mean_time_s']:.1f} s; "
                f"fitted to {error:.2f} intervals"
            )
        assert network is not None
        if finished and file.exists():
            console.print("this run is finished")
            console.print(f"model: {file}", soft_wrap=True)
            return file
        made = {"command": command(), "config": config, "generations": options.generations}
        write_model(file, Model("value", params, network, made))
        console.print(f"model: {file}", soft_wrap=True)
        return file


def _play(
    options: Options,
    generation: int,
    player: Network | None,
    params: SnakeParams,
    label: str,
    console: Console,
) -> list[Returns]:
    """A generation's episodes, in order."""
    parts = [
        Play(
            options.run.seed,
            generation,
            first // _PART,
            count,
            player,
            options.trace_decay if generation >= options.exact else 1.0,
            params,
            options.ground.slip,
        )
        for first in range(0, options.episodes, _PART)
        for count in [min(_PART, options.episodes - first)]
    ]
    played = []
    with progress(console, options.episodes, "episodes") as advance:
        for returns in options.engine.map(play, parts):
            played.append(returns)
            advance(label, parts[returns.part].count)
    return sorted(played, key=lambda returns: returns.part)


def _greedy(played: list[Returns], params: SnakeParams) -> dict[str, float]:
    """How the episodes went that were played greedily throughout."""
    count = sum(returns.strict for returns in played)
    solved = sum(returns.solved for returns in played)
    time_s = sum(returns.time for returns in played) * params.delta_t / max(1, solved)
    return {"success": round(solved / max(1, count), 5), "mean_time_s": round(time_s, 3)}


def _kept(path: Path, generation: int) -> Path:
    return path / f"value-{generation}.safetensors"


def _returns(path: Path, generation: int) -> tuple[np.ndarray, np.ndarray]:
    file = path / f"returns-{generation}.npz"
    try:
        arrays = read_arrays(file, "observations", "intervals", most=_LARGEST)
        if arrays["observations"].ndim != 2 or len(arrays["observations"]) != len(
            arrays["intervals"]
        ):
            raise ArrayFileError("its arrays have inconsistent lengths")
    except ArrayFileError as error:
        expected = f"undamaged returns ({error}; --overwrite begins again)"
        raise InvalidInputError("returns", str(file), expected) from None
    return arrays["observations"], arrays["intervals"]
