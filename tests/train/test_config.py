"""Options in YAML files: what is no value of an option is refused in a line, whatever is there."""

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agents.ppo import Settings
from snake_env.errors import SnakeEnvError
from train import dqn, export, imitate, ppo, value
from train.config import parse_with_file

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join([f'*{chr(97 + k)}'] * 9)}]\n" for k in range(9)
)
BAD: dict[str, tuple[str, str]] = {
    "a number for a path": ("out: 3", r"^out = 3: expected a path$"),
    "a list for a path": ("out: [a]", r"^out = \['a'\]: expected a path$"),
    "half a neuron": ("hidden: [1.5]", r"^hidden\[0\] = 1\.5: expected an integer$"),
    "a neuron alone": ("hidden: 8", r"^hidden = 8: expected a list, each an integer$"),
    "a truth value in a list": ("hidden: [8, true]", r"^hidden\[1\] = True: expected an integer$"),
    "an infinite rate": ("learning_rate: .inf", r"^learning_rate = inf: expected a finite number$"),
    "no rate": ("learning_rate: .nan", r"^learning_rate = nan: expected a finite number$"),
    "a large rate": ("learning_rate: 1e999", r"^learning_rate = inf: expected a finite number$"),
    "nothing": ("learning_rate:", r"^learning_rate = None: expected a finite number$"),
    "a truth value": ("learning_rate: yes", r"^learning_rate = True: expected a finite number$"),
    "a date that is none": ("seed: 2020-13-45", r"^config = .*expected a YAML file \(month"),
    "a date": ("seed: 2020-12-24", r"^seed = .*2020, 12, 24.*: expected an integer$"),
    "a text for an integer": ("seed: many", r"^seed = 'many': expected an integer$"),
    "a number for a truth value": ("resume: 1", r"^resume = 1: expected true or false$"),
    "a number of 10,000 digits": ("seed: " + "9" * 10_000, r"^config = .*expected a YAML file"),
    "a bomb": (BOMB, r"^config = .*aliases are not read"),
    "a key twice": ("seed: 1\nseed: 2", r"^config = .*duplicate key 'seed'"),
    "a merged map": ("<<: {seed: 5}", r"^unknown option in the config '<<'"),
    "an octal number": ("seed: 010", r"^seed = '010': expected an integer$"),
    "an octal rate": ("learning_rate: 010", r"^learning_rate = '010': expected a finite number$"),
    "a grouped rate": ("learning_rate: 1_0", r"^learning_rate = '1_0': expected a finite number$"),
    "numbers for keys of a stage": ("train: {1: 2, foo: 3}", r"^config = .*texts for names"),
    "a number of base 60": ("seed: 1:30", r"^seed = '1:30': expected an integer$"),
    "a grouped number": ("seed: 1_0", r"^seed = '1_0': expected an integer$"),
    "a number of base 16": ("seed: 0x1F", r"^seed = '0x1F': expected an integer$"),
    "an alias": ("seed: &a 3\nseeds: *a", r"^config = .*aliases are not read"),
    "itself": ("reward: &a [*a]", r"^config = .*aliases are not read"),
    "brackets": ("hidden: " + "[" * 3000, r"^config = .*not nested too deeply"),
    "deep maps": ("{a: " * 3000, r"^config = .*not nested too deeply"),
    "a list": ("[1, 2]", r"^config = .*a mapping of options"),
    "numbers for keys": ("1: 2", r"^config = .*a mapping of options"),
    "a list for a key": ("? [a]\n: b", r"^config = .*expected a YAML file"),
    "a tag": ("seed: !!python/object/apply:os.getcwd []", r"^config = .*expected a YAML file"),
    "binary": ("seed: !!binary x", r"^config = .*expected a YAML file"),
    "half a list": ("hidden: [", r"^config = .*expected a YAML file"),
    "no such option": ("sead: 3", r"^unknown option in the config 'sead': did you mean 'seed'\?"),
    "tabs": ("seed:\t3\n\tx", r"^config = .*expected a YAML file"),
    "controls": ("seed: \x1b[31m", r"^config = .*expected a YAML file"),
    "a null character in a path": ('out: "a\\0b"', r"^out = 'a\\x00b': expected a path$"),
    "an engine": ("engine: warp", r"^unknown engine 'warp': known: local, ray"),
}


def _refused(options: Any, *args: object) -> str:
    with pytest.raises(SnakeEnvError) as caught:
        parse_with_file(options, "train", list(map(str, args)))
    told = str(caught.value)
    assert "\n" not in told
    assert len(told) < 1000
    return told


@pytest.mark.parametrize("case", BAD)
def test_bad_file__is_refused_in_a_line(tmp_path: Path, case: str) -> None:
    text, message = BAD[case]
    path = tmp_path / "a.yaml"
    path.write_text(text)
    told = _refused(ppo.Options, "--config", path)
    assert re.search(message, told), told


def test_file_that_cannot_be_read__is_refused(tmp_path: Path) -> None:
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "large.yaml").write_bytes(b"#" * (2**20 + 1))
    for path in (tmp_path, tmp_path / "none", tmp_path / "bytes.yaml", tmp_path / "large.yaml"):
        assert _refused(ppo.Options, "--config", path).startswith("config = ")
    assert "a YAML file" in _refused(ppo.Options, "--config")
    assert "a YAML file" in _refused(ppo.Options, "--config=")
    assert "one file" in _refused(ppo.Options, "--config", "a", "--config=b")


@pytest.mark.parametrize("form", ["--config {}", "--config={}"])
def test_file__changes_the_defaults_and_the_command_line_counts_more(
    tmp_path: Path, form: str
) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(
        "out: runs/x\nhidden: [8, 4]\nlearning_rate: 1e-3\ngamma: 1\nreward: [time=-1]\n"
        "seed: 5\ninit: null\nengine: ray\noverwrite: true\nentropy: 1\n"
    )
    words = [*form.format(path).split(" "), "--seed", "6", "--gamma", "0.5"]
    options = parse_with_file(ppo.Options, "train", words)
    assert options.run.out == Path("runs/x")
    assert options.settings.hidden == (8, 4)
    assert (options.settings.learning_rate, options.settings.gamma) == (1e-3, 0.5)
    assert repr(options.settings.entropy) == "1.0"  # an integer for a number
    assert options.settings.batch_size == Settings().batch_size
    assert options.loop.reward == ("time=-1",)
    assert (options.loop.init, options.run.seed) == (None, 6)
    assert (options.engine.engine, options.run.overwrite) == ("ray", True)


def test_export__takes_a_file_too(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("overwrite: true\nname: own\n")
    options = parse_with_file(export.Options, "train", ["runs/a", "--config", str(path)])
    assert (options.run, options.overwrite, options.name) == (Path("runs/a"), True, "own")
    path.write_text("run: runs/b\n")
    assert parse_with_file(export.Options, "train", [f"--config={path}"]).run == Path("runs/b")
    path.write_text("overwrite: true\n")
    assert "RUN" in _refused(export.Options, f"--config={path}")


def test_file_of_a_recipe__gives_each_command_its_own_options(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("expected: an hour\nppo: {gamma: 0.5}\ndqn: {gamma: 0.6}\n")
    gammas = {
        name: parse_with_file(options, name, ["--config", str(path)]).settings.gamma
        for name, options in (("ppo", ppo.Options), ("dqn", dqn.Options))
    }
    assert gammas == {"ppo": 0.5, "dqn": 0.6}
    path.write_text("ppo: {gama: 0.5}\n")
    with pytest.raises(SnakeEnvError, match="unknown option in the config 'gama'"):
        parse_with_file(ppo.Options, "ppo", ["--config", str(path)])


@pytest.mark.parametrize("options", [ppo.Options, value.Options, export.Options])
def test_help__names_it(options: Any, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parse_with_file(options, "train", ["--help"])
    assert "--config FILE.yaml" in capsys.readouterr().out


UNUSABLE = [
    *(
        "batch_size: 1",
        "hidden: [100000]",
        "hidden: [8, 8, 8, 8, 8, 8, 8, 8, 8, 8, 8, 8, 8, 8, 8, 8, 8]",
    ),
    *("num_envs: 1000000000", "entropy: -1", "n_steps: 1\nnum_envs: 1", "clip_range: -1"),
    *("critic_warmup: -5", "timesteps: 0", "gamma: 1.5"),
]


@pytest.mark.parametrize("text", UNUSABLE)
def test_values_that_no_learner_can_use__are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    options = parse_with_file(ppo.Options, "train", [f"--config={path}"])
    with pytest.raises(SnakeEnvError) as caught:
        options.settings.check()
    assert str(caught.value).startswith(text.split(":")[0])


@pytest.mark.parametrize("flag", ["--learning-rate", "--weight-decay"])
def test_infinite_values_on_the_command_line__are_refused(flag: str) -> None:
    options = parse_with_file(value.Options, "train", [flag, "inf"])
    with pytest.raises(SnakeEnvError, match="inf"):
        options.fit.check()


KEYS = ["out", "seed", "hidden", "reward", "init", "learning_rate", "resume", "engine", "tasks"]
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner),
    max_leaves=6,
)


@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_file__gives_options_or_is_refused(tmp_path: Path, data: st.DataObject) -> None:
    import yaml

    path = tmp_path / "a.yaml"
    crafted = yaml.safe_dump(data.draw(st.dictionaries(st.sampled_from(KEYS), PLAIN)))
    text = data.draw(st.sampled_from([crafted, data.draw(st.text())]))
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    kind: Any = data.draw(st.sampled_from([ppo.Options, dqn.Options, imitate.Options]))
    try:
        options = parse_with_file(kind, "train", ["--config", str(path)])
    except SnakeEnvError as error:
        told = str(error)
    else:
        told = ""
        assert isinstance(options.run.out, Path | None)
        assert all(
            type(size) is int for size in (getattr(options, "settings", None) or options.fit).hidden
        )
    assert "\n" not in told
