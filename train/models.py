"""What a recipe has made: models that know their recipe, and how good they are."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from rich.table import Table

from evaluate.protocol import Row, Shard, run_shard
from evaluate.statistics import summarise
from harness.engine import Engine
from harness.files import read_json
from snake_env.networks.model_file import read_model, write_model
from snake_env.params import SnakeParams
from snake_env.policies.registry import CRITIC
from snake_env.sim.slip import Slip
from snake_env.sim.tasks import load_tasks
from snake_env.system.files import write_atomically
from train.validation import SUITE

SOURCES = {
    "ppo": "ppo/last.safetensors",
    "dqn": "dqn/last.safetensors",
    "imitate": "imitate/last.safetensors",
    "value": "value/value.safetensors",
}
"""The models of a recipe and the stages that made them. Of PPO and DQN the last ones count: they are
means of many, and the tasks of a validation are too few to tell them apart."""
TABLE = "validation.json"
"""How good they are: the file that is written last."""
_PART = 25  # tasks that a worker plays at a time


def ship(
    recipe: Path,
    params: SnakeParams,
    made: Mapping[str, Any],
    count: int,
    slip: Slip,
    engine: Engine,
) -> None:
    """Writes the models of a recipe, and how they do on some tasks beside (21).

    Args:
        recipe: The recipe's folder; the models go to ``models`` in it.
        params: The robot.
        made: What their manifests say about how they were made.
        count: Tasks of validation-2k.
        slip: How much the wheels slip there.
        engine: What plays them.
    """
    models = recipe / "models"
    (models / TABLE).unlink(missing_ok=True)
    policies = {"analytic": "analytic"}
    shipped = {}
    for name, source in SOURCES.items():
        model, file = read_model(recipe / source), models / f"{name}.safetensors"
        shipped[file] = dataclasses.replace(model, made=made)
        write_model(file, shipped[file])
        if model.kind == "policy":
            policies |= {name: str(file), f"{name}{CRITIC}": f"{file}{CRITIC}"}
        else:
            policies[name] = str(file)
    suite = load_tasks(SUITE, params)
    shards = [
        Shard.of(policy, suite, list(range(first, min(first + _PART, count))), params, slip=slip)
        for policy in policies.values()
        for first in range(0, count, _PART)
    ]
    rows: dict[str, list[Row]] = {policy: [] for policy in policies.values()}
    with closing(engine.map(run_shard, shards)) as played:
        for part in played:
            rows[part[0]["policy"]] += part
    table = {}
    for name, policy in policies.items():
        found = summarise(sorted(rows[policy], key=lambda row: row["task"]), (), params)
        table[name] = {
            "success": found["success"],
            "n": found["n"],
            "time_s": found["time_s"]["mean"],
            "restricted_mean_time_s": found["restricted_mean_time_s"],
            "rollouts_per_decision": found["rollouts_per_decision"],
        }
    for file, model in shipped.items():
        own = {key: row for key, row in table.items() if key.partition("+")[0] == file.stem}
        write_model(file, dataclasses.replace(model, made={**made, "validation": own}))
    write_atomically(models / TABLE, json.dumps(table, indent=1) + "\n")


def comparison(models: Path) -> Table:
    """How the models of a recipe do, beside (21)."""
    table = Table(box=None, title=f"on tasks of {SUITE}", title_justify="left")
    for column in ("policy", "success", "mean time [s]", "roll-outs per decision"):
        table.add_column(column, justify="left" if column == "policy" else "right")
    for name, row in read_json(models / TABLE).items():
        share = f"{row['success']}/{row['n']} ({row['success'] / row['n']:.1%})"
        time_s = "-" if row["time_s"] is None else f"{row['time_s']:.1f}"
        table.add_row(name, share, time_s, f"{row['rollouts_per_decision'] or 0.0:.1f}")
    return table
