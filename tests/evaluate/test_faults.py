"""Evaluations that are interrupted while they draw, or meet odd policies, names and settings."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import snake_env
from evaluate import __main__ as command
from evaluate import pictures, protocol, video
from snake_env.params import SnakeParams
from tests.support.commands import Command, names
from tests.support.evaluations import episodes
from tests.support.policies_of_others import OutsideSuite
from train.__main__ import main as train

EVALUATE, TRAIN = Command(command.main), Command(train)
OTHERS = "tests.support.policies_of_others"
QUICK = "--tasks random:2:3 --workers 1 --no-latency"
PPO = Path(snake_env.__file__).parent / "pretrained" / "ppo.safetensors"


@pytest.fixture(autouse=True)
def short_videos(monkeypatch: pytest.MonkeyPatch) -> None:
    """Videos of few frames: what they show is tested elsewhere."""
    monkeypatch.setattr(video, "_MOST_FRAMES", 20)


def _evaluate(words: str, *more: object) -> int:
    return EVALUATE.run(*words.split(), *QUICK.split(), *more)


def _refusal(capsys: pytest.CaptureFixture[str], words: str, *more: object) -> str:
    return EVALUATE.refusal(capsys, *words.split(), *QUICK.split(), *more)


WHOLE = {
    *("episodes.csv", "summary.json", "report.html", "fig4-first-feasible.png"),
    *("sim-1-traces-first-feasible.png", "sim-1-film-first-feasible.png"),
}
PROBLEMS = {
    KeyboardInterrupt(): (130, "interrupted: "),
    OSError(28, "No space left on device"): (1, "error: drawing failed (OSError: [Errno 28] No"),
    ValueError("a picture\nthat fails"): (1, "error: drawing failed (ValueError: a picture that"),
}


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: type(problem).__name__)
def test_drawing_that_ends_early__is_resumed(
    tmp_path: Path, problem: BaseException, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*args: Any) -> None:
        raise problem

    code, told = PROBLEMS[problem]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "figure_5", fail)
        assert _evaluate("first-feasible", "--out", tmp_path) == code
    stderr = capsys.readouterr().err
    assert stderr.startswith(told)
    assert "--resume draws what is missing" in stderr
    assert stderr.count("\n") == 1
    assert len(episodes(tmp_path)) == 2
    assert "report.html" not in names(tmp_path)
    assert _evaluate("first-feasible", "--out", tmp_path, "--resume") == 0
    assert "0 episodes in" in capsys.readouterr().out
    assert names(tmp_path) == WHOLE


def test_finished_run__says_so_and_draws_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert _evaluate("first-feasible", "--out", out, "--resume") == 0  # begins
    assert names(out) == WHOLE
    before = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    capsys.readouterr()
    assert _evaluate("first-feasible", "--out", out, "--resume") == 0
    printed, stderr = capsys.readouterr()
    assert "this run is finished" in printed
    assert stderr == ""
    assert {path.name: path.stat().st_mtime_ns for path in out.iterdir()} == before
    (out / "report.html").unlink()
    assert _evaluate("first-feasible", "--out", out, "--resume", "--video", "1") == 0
    assert {path.stem for path in out.glob("video-*")} == {"video-task-1"}
    assert names(out) >= WHOLE
    drawn = next(out.glob("video-*")).stat().st_mtime_ns
    assert _evaluate("first-feasible", "--out", out, "--resume", "--video", "0,1") == 0
    assert {path.stem for path in out.glob("video-*")} == {"video-task-0", "video-task-1"}
    assert next(out.glob("video-task-1*")).stat().st_mtime_ns == drawn


@pytest.mark.parametrize(
    "words", ["random", "first-feasible --set a_c=70", "first-feasible random"]
)
def test_finished_run__is_not_another_one(
    tmp_path: Path, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _evaluate("first-feasible", "--out", tmp_path, "--no-pictures") == 0
    capsys.readouterr()
    told = _refusal(capsys, words, "--out", tmp_path, "--no-pictures", "--resume")
    assert told.startswith("resume = ")
    for content in ("{}", "null", "[" * 10_000):
        (tmp_path / "summary.json").write_text(content)
        assert _refusal(capsys, "first-feasible", "--out", tmp_path, "--resume")


def test_results_of_one_model__are_not_resumed_with_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, out, words = tmp_path / "a.safetensors", tmp_path / "out", "--no-pictures --resume"
    shutil.copy(PPO, model)

    def run(stop: bool) -> int:
        with pytest.MonkeyPatch.context() as patch:
            if stop:
                patch.setattr(command, "build_summary", lambda *a, **more: 1 / 0)
            return _evaluate(f"{model} --out {out} {words}")

    with pytest.raises(ZeroDivisionError):
        run(stop=True)
    assert (out / "episodes.partial.jsonl").exists()
    shutil.copy(PPO.with_name("imitate.safetensors"), model)
    assert run(stop=False) == 2
    assert "resume" in capsys.readouterr().err
    shutil.copy(PPO, model)
    assert run(stop=False) == run(stop=False) == 0
    shutil.copy(PPO.with_name("imitate.safetensors"), model)
    assert run(stop=False) == 2


def test_model_that_changes_while_it_is_evaluated__is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    model, suite = tmp_path / "a.safetensors", command.load_tasks

    def changed(name: str, params: SnakeParams) -> Any:
        shutil.copy(PPO.with_name("imitate.safetensors"), model)
        return suite(name, params)

    shutil.copy(PPO, model)
    monkeypatch.setattr(command, "load_tasks", changed)  # between the check and the first shard
    assert "it has changed since" in _refusal(capsys, f"{model} --no-pictures")


@pytest.mark.parametrize("name", ["with_texts", "with_none"])
def test_own_policy__may_have_models_of_its_own(name: str, tmp_path: Path) -> None:
    words = f"first-feasible --policy {OTHERS}:{name} --policy {OTHERS}:{name}+shield"
    assert _evaluate(words, "--out", tmp_path, "--no-pictures") == 0
    models = json.loads((tmp_path / "summary.json").read_text())["models"]
    assert set(map(tuple, models.values())) == {()}


def test_policy__is_made_once_for_all_shards_of_a_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    make_policy = protocol.make_policy

    def counted(name: str, params: SnakeParams) -> Any:
        made.append(name)
        return make_policy(name, params)

    monkeypatch.setattr(protocol, "make_policy", counted)
    protocol._made.cache_clear()
    assert _evaluate("ppo first-feasible", "--tasks", "random:6:3") == 0
    assert made == ["ppo", "first-feasible"] * 2  # to see that it exists, and to play six shards
    protocol._made.cache_clear()


def test_timeout__holds_while_pictures_are_made(tmp_path: Path) -> None:
    OutsideSuite.endings.clear()
    words = f"--policy {OTHERS}:OutsideSuite random --decision-timeout 0.5 --video sim-1"
    assert _evaluate(words, "--out", tmp_path) == 0
    assert len(OutsideSuite.endings) >= 2  # the replay in the report, and the film
    assert set(OutsideSuite.endings) == {"DecisionTimeoutError"}
    assert [row["outcome"] for row in episodes(tmp_path)].count("error") == 0
    assert "report.html" in names(tmp_path)


@pytest.mark.parametrize("policy", ["Wandering", "wanderer"])
def test_policy_that_changes_the_folder__loses_nothing(
    tmp_path: Path, policy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(PPO, tmp_path / "own.safetensors")
    words = f"--policy {OTHERS}:{policy} own.safetensors --out out --video 1"
    assert _evaluate(words) == 0
    assert Path.cwd() == tmp_path
    assert names(tmp_path) == {"out", "own.safetensors"}
    assert {row["outcome"] for row in episodes(tmp_path / "out")} <= {
        "success",
        "deadlock",
        "stability",
    }
    assert "report.html" in names(tmp_path / "out")


@pytest.mark.parametrize("policy", ["Screaming", "Unprintable", "Forgetful"])
def test_texts_of_a_policy__never_reach_the_terminal(
    tmp_path: Path, policy: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _evaluate(f"--policy {OTHERS}:{policy}", "--out", tmp_path) == 0
    printed, stderr = capsys.readouterr()
    assert all(char.isprintable() or char == "\n" for char in printed + stderr)
    rows = episodes(tmp_path)
    assert {row["outcome"] for row in rows} == {"error"}
    for row in rows:
        assert row["error"].isprintable()
    assert (tmp_path / "report.html").read_text(encoding="utf-8").count("\x1b") == 0
    if policy == "Screaming":
        assert "[red]no[/blue]" in printed


NAMES = ["res[/red]", "res[new]", "$x^$ {x} é"]


@pytest.mark.parametrize("name", NAMES)
def test_odd_names__are_no_markup_anywhere(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    model = f"{name}.safetensors"
    Path(model).parent.mkdir(exist_ok=True)
    shutil.copy(PPO, model)
    assert EVALUATE.run(model, *QUICK.split(), "--out", f"out-{name}") == 0
    printed = capsys.readouterr().out
    assert f"results: {tmp_path / f'out-{name}'}/\n" in printed
    assert "report.html" in names(tmp_path / f"out-{name}")
    assert list(
        json.loads((tmp_path / f"out-{name}" / "summary.json").read_text())["policies"]
    ) == [model]


@pytest.mark.parametrize("name", ["a\nb", "\x1b[31m", "\udcff", "a\rb", "\u2028"])
def test_controls_in_names__are_refused(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in ([f"{name}.safetensors"], ["random", "--tasks", f"{name}.npz"]):
        assert EVALUATE.run(*words, "--out", tmp_path / "out") == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1
        assert told.strip().isprintable()
    assert names(tmp_path) == set()


def test_long_and_like_names__have_pictures_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    long = Path(*["a" * 60] * 5) / f"{'b' * 200}.safetensors"
    models = [Path("a/b.safetensors"), Path("a-b.safetensors"), Path("A-b.safetensors"), long]
    for path in models:
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(PPO, path)
    assert _evaluate(" ".join(map(str, models)), "--out", "out") == 0
    drawn = {path.name.casefold() for path in Path("out").glob("fig4-*.png")}
    assert len(drawn) == len(models)
    assert max(map(len, drawn)) < 100


BACKENDS = ["module://matplotlib_inline.backend_inline", "nonsense", "tkagg"]


@pytest.mark.parametrize("backend", BACKENDS)
def test_backend__does_not_matter(tmp_path: Path, backend: str) -> None:
    EVALUATE.process("random", *QUICK.split(), "--out", tmp_path, MPLBACKEND=backend)
    assert "fig4-random.png" in names(tmp_path)


def test_backend__does_not_matter_to_train(tmp_path: Path) -> None:
    backend = BACKENDS[0]
    TRAIN.process("ppo", "--help", MPLBACKEND=backend)
    words = "--timesteps 256 --num-envs 16 --n-steps 16 --hidden 8 --validation-tasks 1"
    TRAIN.process("ppo", *words.split(), "--out", tmp_path, MPLBACKEND=backend)
    assert "curve.png" in names(tmp_path)


def test_style_of_the_user__does_not_matter(tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_text(
        "text.usetex: True\nsavefig.format: pdf\nfont.size: 90\n"
    )
    words = ("random", *QUICK.split(), "--out", tmp_path / "out")
    EVALUATE.process(*words, MPLCONFIGDIR=str(tmp_path))
    assert (tmp_path / "out" / "fig4-random.png").read_bytes().startswith(b"\x89PNG")
