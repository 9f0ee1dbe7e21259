"""Compiled code: kept for the next process, mended when damaged, done without when it can't be."""

import hashlib
import os
import re
import stat
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from snake_env.equations.tracing import Trace
from snake_env.kernel import compiler
from snake_env.kernel.emission import emit
from tests.support import ROOT
from tests.support.commands import python

PREDICT = """
import numpy as np
from snake_env.params import SnakeParams
from snake_env.sim.simulation import predict
from snake_env.state import SnakeState
params = SnakeParams(n_joints=5)
state = SnakeState.initial([0.3] * 5, [0.1, -0.2, 0.3, 0.4, -0.5], params)
print(predict(state, [0, 1, 2], params).j.tobytes().hex())
"""


def _python(code: str, cache: Path) -> subprocess.CompletedProcess[str]:
    return python("-c", code, **{compiler.CACHE_VARIABLE: str(cache)})


def _ir(added: float, lanes: int = 8) -> str:
    """Code that adds a number to row 0 and stores the sum in row 1."""
    trace = Trace()
    trace.store(1, trace.lane(0) + added)
    return emit(Trace(), trace, 2, 0, 1, lanes)


def _call(function: compiler.BlockFunction) -> float:
    raw = np.zeros(3 * 8)
    block = raw[-(raw.ctypes.data // 8) % 8 :][:16]
    block[:8] = 1.0
    function(block.ctypes.data, 0, 0, 0, 1)
    assert len(set(block[8:16])) == 1
    return float(block[8])


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder of this test's own."""
    folder = tmp_path / "cache"
    monkeypatch.setenv(compiler.CACHE_VARIABLE, str(folder))
    return folder


def test_second_process__compiles_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "cache"
    first = _python(PREDICT, folder)
    assert first.stderr.count("compiling the kernel for 5 joints, once") == 1
    before = {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in folder.iterdir()}
    assert len(before) == 2  # the interval, and the distances that a new state is checked by
    second = _python(PREDICT, folder)
    assert second.stderr == ""
    assert second.stdout == first.stdout
    after = {path: (path.stat().st_mtime_ns, path.stat().st_ino) for path in folder.iterdir()}
    assert after == before


def test_unwritable_cache__warns_and_still_works(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    done = _python(PREDICT, tmp_path / "file" / "cache")
    assert "RuntimeWarning: can't keep compiled code in" in done.stderr
    assert compiler.CACHE_VARIABLE in done.stderr
    assert "every process compiles it again" in done.stderr
    assert done.stdout == _python(PREDICT, tmp_path / "writable").stdout
    assert (tmp_path / "file").read_text() == "not a folder"


def test_load__announces_what_it_compiles_once(
    cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert _call(compiler.load(_ir(2.0), "a test")) == 3.0
    assert [record.getMessage() for record in caplog.records] == [
        "compiling the kernel for a test, once"
    ]
    caplog.clear()
    assert _call(compiler.load(_ir(2.0), "a test")) == 3.0
    assert not caplog.records
    assert len(list(cache.iterdir())) == 1


def test_load__keeps_different_code_apart(cache: Path) -> None:
    functions = [compiler.load(_ir(added), "a test") for added in (2.0, 3.0, 2.0)]
    assert [_call(function) for function in functions] == [3.0, 4.0, 3.0]
    assert len(list(cache.iterdir())) == 2


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[:40],
        lambda data: data[:-1],
        lambda data: data[:100] + bytes([data[100] ^ 1]) + data[101:],
        lambda data: bytes(32) + data[32:],
        lambda data: b"\0" * len(data),
    ],
    ids=["empty", "header", "truncated", "flipped", "digest", "zeros"],
)
def test_damaged_cache__is_compiled_again_and_mended(
    cache: Path, caplog: pytest.LogCaptureFixture, damage: Callable[[bytes], bytes]
) -> None:
    compiler.load(_ir(2.0), "a test")
    (path,) = cache.iterdir()
    good = path.read_bytes()
    path.write_bytes(damage(good))
    caplog.clear()
    assert _call(compiler.load(_ir(2.0), "a test")) == 3.0
    assert "compiling" in caplog.text
    assert path.read_bytes() == good
    assert hashlib.sha256(good[32:]).digest() == good[:32]
    assert list(cache.iterdir()) == [path]  # no half-written file is left behind


def test_failed_write__warns_and_leaves_no_half_written_file(cache: Path) -> None:
    compiler.load(_ir(2.0), "a test")
    (path,) = cache.iterdir()
    path.unlink()
    path.mkdir()  # a folder where the file belongs
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert _call(compiler.load(_ir(2.0), "a test")) == 3.0
    assert [w.category for w in caught] == [RuntimeWarning]
    assert list(cache.iterdir()) == [path]


def test_cache_folder__is_the_users_unless_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(compiler.CACHE_VARIABLE, str(tmp_path))
    assert compiler.cache_folder() == tmp_path
    monkeypatch.delenv(compiler.CACHE_VARIABLE)
    assert compiler.cache_folder().name == "snake-mode-env"


@pytest.mark.skipif(os.name != "posix", reason="needs rights and users of POSIX")
@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_cache__can_be_read_by_all_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, umask: int
) -> None:
    folder = tmp_path / "new" / "cache"
    monkeypatch.setenv(compiler.CACHE_VARIABLE, str(folder))
    before = os.umask(umask)
    try:
        compiler.load(_ir(2.0), "a test")
    finally:
        os.umask(before)
    (path,) = folder.iterdir()
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    assert stat.S_IMODE(folder.stat().st_mode) == 0o755


HOMELESS = """
import os, pwd, sys
os.environ.pop("HOME", None)
for name in [key for key in os.environ if key.startswith("XDG")]:
    del os.environ[name]
def nobody(uid):
    raise KeyError(f"getpwuid(): uid not found: {uid}")
pwd.getpwuid = nobody
from snake_env.kernel import compiler
os.environ.update(dict(pair.split("=", 1) for pair in sys.argv[1:]))
print(compiler.cache_folder())
"""


@pytest.mark.skipif(os.name != "posix", reason="needs rights and users of POSIX")
@pytest.mark.parametrize("variables", [(), ("HOME=",), ("HOME=somewhere",), ("XDG_CACHE_HOME=x",)])
def test_user_without_home__compiles_without_a_cache(
    tmp_path: Path, variables: tuple[str, ...]
) -> None:
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", HOMELESS + PREDICT, *variables],
        cwd=tmp_path, env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stdout[:5]) == (0, "None\n"), done.stderr
    assert "without a home folder" in done.stderr
    assert list(tmp_path.iterdir()) == []  # nor is there a folder named ~


@given(st.binary(max_size=200))
def test_any_bytes_in_the_cache__are_no_code(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "key.bin"
        path.write_bytes(content)
        assert compiler._read_cache(path) is None
        code = hashlib.sha256(content).digest() + content
        path.write_bytes(code)
        assert compiler._read_cache(path) == content
        for at in range(0, 8 * len(code), 7):  # single bits
            path.write_bytes(
                code[: at // 8] + bytes([code[at // 8] ^ (1 << at % 8)]) + code[at // 8 + 1 :]
            )
            assert compiler._read_cache(path) is None


def test_what_is_no_file_in_the_cache__is_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.bin"
    os.mkfifo(pipe)
    for path in (pipe, tmp_path, tmp_path / "missing.bin", pipe / "below.bin"):
        assert compiler._read_cache(path) is None


@pytest.mark.parametrize("lanes", [1, 2, 8])
def test_emit__promises_no_more_alignment_than_a_row_has(lanes: int) -> None:
    promised = {int(number) for number in re.findall(r"x double>.*align (\d+)", _ir(2.0, lanes))}
    assert promised
    assert max(promised) <= 8 * lanes


def test_emit__uses_strict_arithmetic_only() -> None:
    trace = Trace()
    a, b = trace.lane(0), trace.lane(1)
    trace.store(1, (-a * b + a / b - (a - b).sqrt()))
    ir = emit(Trace(), trace, 2, 0, 1, 8)
    for name in ("fadd", "fsub", "fmul", "fdiv", "fneg"):
        assert re.search(rf" = {name} <8 x double> ", ir), name
    flags = ("fast", "contract", "reassoc", "nnan", "ninf", "arcp", "afn", "nsz")
    assert not re.search(rf"\b({'|'.join(flags)})\b", ir)
