"""Files of arrays that anybody may have made: nothing but the named arrays is read, in bounds."""

import io
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from snake_env.errors import InvalidInputError
from snake_env.sim.array_file import ArrayFileError, read_arrays
from snake_env.sim.tasks import load_tasks
from tests.support.damage import damaged
from tests.support.robots import PAPER

SHAPES = np.random.default_rng(0).uniform(-0.2, 0.2, (30, 8))
MEMBERS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)


def _npy(array: np.ndarray, **header: Any) -> bytes:
    """The bytes of an array, under a header that may say something else."""
    file = io.BytesIO()
    told = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape} | header
    np.lib.format.write_array_header_1_0(file, told)
    return file.getvalue() + array.tobytes()


def _raw(header: bytes) -> bytes:
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header


def _zip(path: Path, method: int = zipfile.ZIP_STORED, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", method) as file:
        for name, content in members.items():
            file.writestr(f"{name}.npy", content)
    return path


def _peak_mib(path: Path) -> float:
    tracemalloc.start()
    try:
        load_tasks(path, PAPER)
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()


def test_members_that_nobody_asked_for__cost_nothing(tmp_path: Path) -> None:
    zeros, good = np.zeros(2**24), _npy(SHAPES)  # 128 MiB, compressed to 128 KiB
    more = {f"more{k}": _npy(zeros) for k in range(2)} | {"broken": b"no array"}
    path = _zip(tmp_path / "own.npz", zipfile.ZIP_DEFLATED, phi0=good, target=good, **more)
    del zeros, more
    assert path.stat().st_size < 2**20
    assert _peak_mib(path) < 4.0


CRAFTED = {
    "more rows than there are": _npy(SHAPES, shape=(31, 8)),
    "fewer rows than there are": _npy(SHAPES, shape=(29, 8)),
    "terabytes": _npy(SHAPES, shape=(10**12, 8)),
    "more than there are atoms": _npy(SHAPES, shape=(10**80, 8)),
    "nothing of something huge": _npy(SHAPES[:0], shape=(0, 10**30)),
    "a negative size": _npy(SHAPES, shape=(-30, -8)),
    "many dimensions": _npy(SHAPES, shape=(1,) * 60 + (30, 8)),
    "objects": _npy(SHAPES, descr="|O"),
    "texts": _npy(SHAPES, descr="<U2"),
    "records": _npy(SHAPES, descr=[("a", "<f4"), ("b", "<f4")]),
    "another version": b"\x93NUMPY\x09\x00" + _npy(SHAPES)[8:],
    "an expression": _raw(b"{'descr': '<f8', 'fortran_order': False, 'shape': (2**99, 8)}\n"),
    "brackets": _raw(b"(" * 9000 + b"\n"),
    "half a header": _raw(b"{'descr': '<f8'"),
    "a long header": _raw(b" " * 60_000),
}


@pytest.mark.parametrize("content", CRAFTED.values(), ids=CRAFTED.keys())
def test_crafted_header__is_refused(tmp_path: Path, content: bytes) -> None:
    path = _zip(tmp_path / "own.npz", phi0=content, target=_npy(SHAPES))
    with pytest.raises(InvalidInputError, match=r"own\.npz") as caught:
        load_tasks(path, PAPER)
    assert "\n" not in str(caught.value)


def test_more_than_the_limit__is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = _zip(tmp_path / "own.npz", zipfile.ZIP_DEFLATED, phi0=_npy(np.zeros(2**18)))
    assert read_arrays(path, "phi0", most=2**21)["phi0"].shape == (2**18,)
    with pytest.raises(ArrayFileError, match="2,097,152 bytes; at most 2,097,151 are read"):
        read_arrays(path, "phi0", most=2**21 - 1)


@pytest.mark.parametrize("method", MEMBERS)
@pytest.mark.parametrize("at", [0.2, 0.5, 0.8])
def test_damage__is_noticed_whatever_the_compression(
    tmp_path: Path, method: int, at: float
) -> None:
    good = _npy(SHAPES)
    path = _zip(tmp_path / "own.npz", method, phi0=good, target=good)
    data = bytearray(path.read_bytes())
    data[int(at * len(data))] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(InvalidInputError):
        load_tasks(path, PAPER)


def test_fortran_order_and_big_endian__are_read(tmp_path: Path) -> None:
    path = tmp_path / "own.npz"
    np.savez(path, phi0=np.asfortranarray(SHAPES), target=SHAPES.astype(">f8"))
    suite = load_tasks(path, PAPER)
    assert np.array_equal(suite.phi0, SHAPES)
    assert np.array_equal(suite.target, SHAPES)


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_bytes__are_tasks_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    good = _npy(SHAPES)
    path = _zip(tmp_path / "own.npz", data.draw(st.sampled_from(MEMBERS)), phi0=good, target=good)
    path.write_bytes(damaged(path.read_bytes(), data))
    try:
        assert np.isfinite(load_tasks(path, PAPER).phi0).all()
    except InvalidInputError as error:
        problem = str(error)
    else:
        problem = ""
    assert "\n" not in problem
