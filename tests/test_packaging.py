"""What is shipped: the wheel, what an import costs, the Makefile and the README."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from snake_env.kernel.compiler import CACHE_VARIABLE
from tests.support import HANGS_S, ROOT
from tests.support.commands import python

LOCKS = sorted(path.name for path in (ROOT / "requirements").glob("*.txt"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
HEAVY = {
    *("torch", "stable_baselines3", "matplotlib", "scipy", "joblib", "rich", "tyro", "pygame"),
    *("moviepy", "numba", "pandas"),
}


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project as a checkout has it, without what is built there."""
    folder = tmp_path_factory.mktemp("copy") / "project"
    ignored = shutil.ignore_patterns(
        *(".git", ".venv*", ".*_cache", ".hypothesis", "__pycache__", "build", "dist"),
        *("*.egg-info", "report", "runs", "shared"),
    )
    shutil.copytree(ROOT, folder, ignore=ignored)
    return folder


@pytest.fixture(scope="module")
def wheel(copy: Path) -> zipfile.ZipFile:
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", copy / "dist", copy],
        check=True, capture_output=True, timeout=HANGS_S,
    )  # fmt: skip
    (path,) = (copy / "dist").iterdir()
    assert path.name.startswith("snake_mode_env-")
    return zipfile.ZipFile(path)


def _names(wheel: zipfile.ZipFile) -> list[str]:
    return [name for name in wheel.namelist() if ".dist-info/" not in name]


def test_wheel__has_one_top_level_name(wheel: zipfile.ZipFile) -> None:
    assert {name.split("/")[0] for name in _names(wheel)} == {"snake_env"}


def test_wheel__has_the_whole_package(wheel: zipfile.ZipFile) -> None:
    package = (ROOT / "snake_env").rglob("*")
    expected = {
        path.relative_to(ROOT).as_posix()
        for path in package
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert set(_names(wheel)) == expected
    assert {"snake_env/policies/analytic_14.json", "snake_env/py.typed"} <= expected


def test_wheel__is_small_enough(wheel: zipfile.ZipFile) -> None:
    assert sum(entry.compress_size for entry in wheel.infolist()) < 12_000_000


def test_wheel__names_its_licence_and_needs_nothing_heavy(wheel: zipfile.ZipFile) -> None:
    (metadata,) = [name for name in wheel.namelist() if name.endswith(".dist-info/METADATA")]
    text = wheel.read(metadata).decode()
    assert re.search(r"^Name: snake-mode-env$", text, re.MULTILINE)
    assert any(name.endswith("/LICENSE") for name in wheel.namelist())
    needed = re.findall(r"^Requires-Dist: ([\w-]+)(?!.*extra ==)", text, re.MULTILINE)
    assert not {name.lower().replace("-", "_") for name in needed} & HEAVY
    assert "numpy" in needed


def test_wheel__works_without_the_checkout(wheel: zipfile.ZipFile, tmp_path: Path) -> None:
    wheel.extractall(tmp_path)
    program = (
        "import snake_env, sys; policy = snake_env.load_policy('analytic-14');"
        "params = snake_env.SnakeParams();"
        "state = snake_env.load_tasks('sim-1', params).initial(0, params);"
        "print(snake_env.__file__, policy.select_mode(state), policy.rollouts)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    place, _, rollouts = done.stdout.split()
    assert Path(place).is_relative_to(tmp_path)
    assert rollouts == "14"


def test_import__needs_nothing_heavy_and_compiles_nothing(tmp_path: Path) -> None:
    program = "import sys, snake_env; print(*{name.split('.')[0] for name in sys.modules})"
    done = python("-c", program, **{CACHE_VARIABLE: str(tmp_path / "cache")})
    loaded = set(done.stdout.split())
    assert "snake_env" in loaded
    assert not loaded & HEAVY
    assert not loaded & {"agents", "evaluate", "train"}
    assert done.stderr == ""
    assert not (tmp_path / "cache").exists()


def _targets() -> set[str]:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    return set(re.findall(r"^([a-z][\w-]*):", makefile, re.MULTILINE))


def test_makefile__has_the_promised_targets() -> None:
    assert {"setup", "demo", "test", "check", "bench"} <= _targets()


def test_readme__names_commands_that_exist() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"\bmake ([a-z][\w-]*)", "\n".join(re.findall(r"`+[^`]+`+", readme))))
    assert {"demo", "test"} <= named
    assert named <= _targets()
    for module in re.findall(r"python -m (\w+(?:\.\w+)*)", readme):
        path = ROOT.joinpath(*module.split("."))
        assert path.is_dir() or path.with_suffix(".py").is_file() or module in ("pip", "venv")
    for picture in re.findall(r"!\[[^\]]*\]\(([^)#]+)\)", readme):
        assert picture.startswith("http") or (ROOT / picture).is_file()


def _requirements(extra: str) -> set[str]:
    """What an extra brings, with the extras of this project that it takes in."""
    found: set[str] = set()
    for requirement in PROJECT["optional-dependencies"][extra]:
        own = re.match(r"snake-mode-env\[([\w,-]+)\]", requirement)
        names = own[1].split(",") if own else []
        found |= set().union(*map(_requirements, names))
        if not own:
            found.add(re.match(r"[\w-]+", requirement)[0].lower())
    return found


def test_demo__needs_no_torch(copy: Path) -> None:
    done = subprocess.run(
        ["make", "-n", "demo"], cwd=copy, check=True, capture_output=True, text=True, env=_clean()
    )
    installs = [line for line in done.stdout.splitlines() if "pip install" in line]
    assert installs
    assert {name for line in installs for name in re.findall(r"requirements/\S+", line)} == {
        "requirements/evaluate.txt"
    }
    assert not _pinned("evaluate.txt") & {"torch", "stable-baselines3", "ray"}
    assert not _requirements("evaluate") & {"torch", "stable-baselines3"}
    assert "torch" in _requirements("dev")
    assert "-m evaluate analytic" in done.stdout
    assert "--tasks paper-500" in done.stdout


def _clean() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}


def _pinned(lock: str) -> set[str]:
    """The packages of a lock, canonical names."""
    text = (ROOT / "requirements" / lock).read_text(encoding="utf-8")
    return {re.sub(r"[_.]+", "-", name).lower() for name in re.findall(r"^([\w.-]+)==", text, re.M)}


def test_locks__pin_every_requirement() -> None:
    core = {re.match(r"[\w-]+", line)[0].lower() for line in PROJECT["dependencies"]}
    wanted = core | set().union(*map(_requirements, PROJECT["optional-dependencies"]))
    assert wanted <= _pinned("dev.txt") | _pinned("torch.txt")
    assert core | _requirements("evaluate") <= _pinned("evaluate.txt")
    assert _pinned("torch.txt") == {"torch"}
    torch = (ROOT / "requirements" / "torch.txt").read_text(encoding="utf-8")
    assert "torch==2.13.0 " in torch


@pytest.mark.parametrize("lock", LOCKS)
def test_lock__has_a_hash_for_every_package(lock: str) -> None:
    text = (ROOT / "requirements" / lock).read_text(encoding="utf-8")
    entries = re.split(r"^(?=[\w.-]+==)", text, flags=re.MULTILINE)[1:]
    assert entries
    for entry in entries:
        assert re.search(r"--hash=sha256:[0-9a-f]{64}\b", entry), entry.splitlines()[0]
