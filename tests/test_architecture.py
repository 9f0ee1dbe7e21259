"""Dependencies run one way, and the physics needs nothing heavy."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "snake_env"
# A module may import only from modules before it. The head of the list is the physics: it knows
# nothing of Gymnasium.
ORDER = [
    *("errors", "params", "tracing", "scalars", "kinematics", "modes", "state"),
    *("control", "cost", "stability", "features", "compiler", "blocks", "kernel", "lane_function"),
    *(
        "mask_kernel",
        "simulation",
        "optimizer",
        "tasks",
        "masks",
        "episode",
        "reward",
        "skid",
        "slip",
    ),
    *("observation", "ends", "programs", "network", "symmetry", "model_file", "value", "search"),
    *("policy", "lookahead", "network_policy", "shield"),
    *("transition", "core", "drawing", "rendering", "env", "wrappers"),
    *("policies", "best_known", "vector_env", "sb3"),
    *("__init__", "__main__"),
]
PHYSICS = ORDER[: ORDER.index("env")]
NEVER_AT_MODULE_LEVEL = {
    "torch",
    "stable_baselines3",
    "sb3_contrib",
    "matplotlib",
    "numba",
    "scipy",
}
ADAPTERS = {"sb3": {"stable_baselines3", "torch"}}  # imported by no other module
NEVER = {"evaluate", "train", "agents", "tests"}
MODULES = sorted(PACKAGE.rglob("*.py"))


def _layer(path: Path) -> str:
    """The name in ORDER of a module: a sub-package is one layer."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def _nodes(tree: ast.AST, everywhere: bool) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        for_types = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if everywhere or not (function or for_types):
            yield node
            yield from _nodes(node, everywhere)


def _imports(path: Path, everywhere: bool = True) -> set[str]:
    """Dotted names of what a module imports; ``from a import b`` gives ``a.b``."""
    names: set[str] = set()
    for node in _nodes(ast.parse(path.read_text()), everywhere):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = path.relative_to(PACKAGE.parent).parts[: -node.level]
                base = ".".join([*parts, base]).strip(".")
            names |= {f"{base}.{alias.name}" for alias in node.names}
    return names


def _own(path: Path) -> set[str]:
    """Layers of this package that a module imports from."""
    layers = set()
    for name in _imports(path):
        top, *rest = name.split(".")
        if top == "snake_env":
            known = rest and (PACKAGE / rest[0]).with_suffix(".py").exists()
            known = known or (rest and (PACKAGE / rest[0] / "__init__.py").exists())
            layers.add(rest[0] if known else "__init__")
    return layers - {_layer(path)}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_module__imports_only_from_layers_before_its_own(path: Path) -> None:
    assert _layer(path) in ORDER, "give the new module its place in ORDER"
    before = ORDER[: ORDER.index(_layer(path))]
    assert _own(path) <= set(before)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_module__never_imports_what_runs_from_the_checkout(path: Path) -> None:
    assert not {name.split(".")[0] for name in _imports(path)} & NEVER


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_module__imports_nothing_heavy_at_its_top(path: Path) -> None:
    tops = {name.split(".")[0] for name in _imports(path, everywhere=False)}
    assert not tops & NEVER_AT_MODULE_LEVEL - ADAPTERS.get(_layer(path), set())
    assert not _own(path) & set(ADAPTERS)


def test_physics__knows_nothing_of_gymnasium() -> None:
    for path in MODULES:
        if _layer(path) in PHYSICS:
            assert not any(name.split(".")[0] == "gymnasium" for name in _imports(path)), path


def test_imports__are_seen_however_they_are_written(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(
        "import torch.nn as nn\n"
        "if True:\n    from evaluate.table import row\n"
        "class A:\n    import agents\n"
        "def f():\n    from snake_env import tasks\n"
        "if TYPE_CHECKING:\n    import gymnasium\n"
    )
    seen = {"torch.nn", "evaluate.table.row", "agents"}
    assert _imports(path, everywhere=False) == seen
    assert _imports(path) == seen | {"snake_env.tasks", "gymnasium"}


def test_order__names_the_physics() -> None:
    present = {_layer(path) for path in MODULES}
    assert {"params", "state", "modes", "kinematics", "control", "cost", "stability"} <= present
    assert {"kernel", "simulation", "optimizer", "tasks"} <= present
    assert len(set(ORDER)) == len(ORDER)
