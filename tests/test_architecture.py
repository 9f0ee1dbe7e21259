"""Dependencies run one way, and the physics needs nothing heavy."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tests.support import ROOT

PACKAGE = ROOT / "snake_env"
# The rooms, floor by floor: a room may import only from rooms before it.
ROOMS = [
    *("errors", "system", "params", "equations", "modes", "kernel", "state", "sim", "networks"),
    *("rendering", "envs", "policies", "sb3", "__init__", "__main__"),
]
PHYSICS = ROOMS[: ROOMS.index("envs")]
MOST_ROOMS = 16
MOST_LINES = 300
NEVER_AT_MODULE_LEVEL = {
    *("torch", "stable_baselines3", "sb3_contrib", "matplotlib", "numba", "scipy")
}
ADAPTERS = {"sb3": {"stable_baselines3", "torch"}}  # imported by no other module
# What runs from the checkout, and what each of these packages may import beside itself and snake_env.
CHECKOUT = {
    "harness": set(),
    "agents": {"harness"},
    "evaluate": {"harness"},
    "train": {"harness", "agents", "evaluate.protocol", "evaluate.statistics"},
    "benchmarks": {"harness", "agents", "evaluate", "train"},
}
NEVER = {*CHECKOUT, "tests"}
MODULES = sorted(PACKAGE.rglob("*.py"))


def _room(path: Path) -> str:
    """The room that a module is in: a folder, or a module at the top."""
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
    """Rooms of this package that a module imports from."""
    rooms = set()
    for name in _imports(path):
        top, *rest = name.split(".")
        if top == "snake_env":
            known = rest and (PACKAGE / rest[0]).with_suffix(".py").exists()
            known = known or (rest and (PACKAGE / rest[0] / "__init__.py").exists())
            rooms.add(rest[0] if known else "__init__")
    return rooms - {_room(path)}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_module__imports_only_from_rooms_before_its_own(path: Path) -> None:
    assert _room(path) in ROOMS, "give the new room its place in ROOMS"
    assert _own(path) <= set(ROOMS[: ROOMS.index(_room(path))])


@pytest.mark.parametrize("room", [name for name in ROOMS if (PACKAGE / name).is_dir()])
def test_room__has_no_circle_of_imports_inside(room: str) -> None:
    inside = {}
    for path in (PACKAGE / room).glob("*.py"):
        prefix = f"snake_env.{room}."
        named = {name.removeprefix(prefix).split(".")[0] for name in _imports(path, False)}
        inside[path.stem] = {n for n in named if (PACKAGE / room / f"{n}.py").exists()}
    assert list(TopologicalSorter(inside).static_order())  # a circle raises CycleError


def test_package__has_few_rooms_and_short_files() -> None:
    rooms = {path.name for path in PACKAGE.iterdir()} - {"__pycache__", "py.typed"}
    assert len(rooms) <= MOST_ROOMS
    for top in ("snake_env", *CHECKOUT):
        for path in (ROOT / top).rglob("*.py"):
            assert len(path.read_text().splitlines()) <= MOST_LINES, path


def test_tests__have_the_same_rooms_and_import_no_other_test() -> None:
    names = {path.name for path in (ROOT / "tests").iterdir() if path.is_dir()}
    rooms = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert names - {"__pycache__"} == rooms | {"support", "docs", *CHECKOUT}
    for path in (ROOT / "tests").rglob("test_*.py"):
        assert not {name for name in _imports(path) if ".test_" in name or ".conftest" in name}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_module__never_imports_what_runs_from_the_checkout(path: Path) -> None:
    assert not {name.split(".")[0] for name in _imports(path)} & NEVER


@pytest.mark.parametrize("top", CHECKOUT)
def test_checkout__imports_only_what_it_may(top: str) -> None:
    allowed = CHECKOUT[top] | {top}
    tops = {*CHECKOUT, "tests"}
    for path in (ROOT / top).rglob("*.py"):
        others = {name for name in _imports(path) if name.split(".")[0] in tops}
        wrong = {n for n in others if not any(f"{n}.".startswith(f"{own}.") for own in allowed)}
        assert not wrong, path


def test_checkout__has_no_circle_of_packages() -> None:
    order = {top: {name.split(".")[0] for name in names} for top, names in CHECKOUT.items()}
    assert list(TopologicalSorter(order).static_order())  # a circle raises CycleError


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_module__imports_nothing_heavy_at_its_top(path: Path) -> None:
    tops = {name.split(".")[0] for name in _imports(path, everywhere=False)}
    assert not tops & NEVER_AT_MODULE_LEVEL - ADAPTERS.get(_room(path), set())
    assert not _own(path) & set(ADAPTERS)


def test_physics__knows_nothing_of_gymnasium() -> None:
    for path in MODULES:
        if _room(path) in PHYSICS:
            assert not any(name.split(".")[0] == "gymnasium" for name in _imports(path)), path


def test_imports__are_seen_however_they_are_written(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(
        "import torch.nn as nn\n"
        "if True:\n    from evaluate.table import row\n"
        "class A:\n    import agents\n"
        "def f():\n    from snake_env.sim import tasks\n"
        "if TYPE_CHECKING:\n    import gymnasium\n"
    )
    seen = {"torch.nn", "evaluate.table.row", "agents"}
    assert _imports(path, everywhere=False) == seen
    assert _imports(path) == seen | {"snake_env.sim.tasks", "gymnasium"}
