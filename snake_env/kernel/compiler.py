"""Turns LLVM IR into machine code, and keeps it for the next process."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import logging
import os
import warnings
from collections.abc import Callable
from pathlib import Path

import llvmlite
import llvmlite.binding as llvm
import platformdirs

from snake_env.system.files import write_atomically

CACHE_VARIABLE = "SNAKE_ENV_CACHE_DIR"
_log = logging.getLogger(__name__)
_ENGINES: list[llvm.ExecutionEngine] = []
_MACHINE_OPTIONS = {"opt": 2, "reloc": "pic"}
_PASS_OPTIONS = {"speed_level": 1}
_LARGEST_CODE = 64 * 2**20  # bytes; kernels have about a hundredth of it

BlockFunction = Callable[[int, int, int, int, int], None]
"""Addresses of the first block, the constants and the clock's row; sub-steps and blocks to run."""


def vector_bits() -> int:
    """Width of this processor's vector registers."""
    features = llvm.get_host_cpu_features().flatten()
    return 512 if "+avx512f" in features else 256 if "+avx2" in features else 128


@functools.cache
def _provide_fma() -> None:
    """Lets machine code find the C library's fma, which processors without that instruction call."""
    library = ctypes.CDLL("ucrtbase" if os.name == "nt" else None)
    llvm.add_symbol("fma", ctypes.cast(library.fma, ctypes.c_void_p).value)


def load(ir: str, what: str) -> BlockFunction:
    """Machine code of ``run`` in the IR: from the cache, or compiled (and announced) and cached.

    Args:
        ir: What :func:`snake_env.kernel.emission.emit` made, or a module with a function of its kind.
        what: Name of the kernel in the announcement.
    """
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    _provide_fma()
    cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    machine = llvm.Target.from_default_triple().create_target_machine(
        cpu=cpu, features=features, **_MACHINE_OPTIONS
    )
    made_by = (llvmlite.__version__, llvm.llvm_version_info, cpu, features)
    made_how = (sorted(_MACHINE_OPTIONS.items()), sorted(_PASS_OPTIONS.items()))
    key = hashlib.sha256(f"{made_by}{made_how}{ir}".encode()).hexdigest()[:32]
    folder = cache_folder()
    code = None if folder is None else _read_cache(folder / f"{key}.bin")
    if code is None:
        _log.warning("compiling the kernel for %s, once", what)
        module = llvm.parse_assembly(ir)
        module.triple = machine.triple
        options = llvm.create_pipeline_tuning_options(**_PASS_OPTIONS)
        builder = llvm.create_pass_builder(machine, options)
        builder.getModulePassManager().run(module, builder)
        code = machine.emit_object(module)
        if folder is None:
            _warn("without a home folder")
        else:
            _write_cache(folder / f"{key}.bin", code)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    pointer, integer = ctypes.c_void_p, ctypes.c_int64
    prototype = ctypes.CFUNCTYPE(None, pointer, pointer, pointer, integer, integer)
    function = prototype(engine.get_function_address("run"))
    _ENGINES.append(engine)  # its memory holds the code
    return function


def cache_folder() -> Path | None:
    """Where compiled kernels are kept: ``$SNAKE_ENV_CACHE_DIR``, or the user's cache folder.

    None where the user has no home: neither ``$HOME`` nor an entry in the list of users.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen:
        return Path(chosen)
    try:
        folder = platformdirs.user_cache_path("snake-mode-env")
    except (RuntimeError, LookupError):
        return None
    return folder if folder.is_absolute() else None  # "~/..." where ~ stands for nothing


def _read_cache(path: Path) -> bytes | None:
    """The cached machine code, unless there is none or the file is damaged."""
    try:
        if not path.is_file() or path.stat().st_size > _LARGEST_CODE:
            return None
        data = path.read_bytes()
    except OSError:
        return None
    digest, code = data[:32], data[32:]
    return code if hashlib.sha256(code).digest() == digest else None


def _write_cache(path: Path, code: bytes) -> None:
    """Keeps machine code for other processes and users; a reader never sees half a file."""
    try:
        if not path.parent.is_dir():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.parent.chmod(0o755)  # whatever the umask: code is no secret
        write_atomically(path, hashlib.sha256(code).digest() + code, 0o644)
    except OSError as error:
        _warn(f"in {path.parent} ({error.strerror})")


def _warn(where: str) -> None:
    warnings.warn(
        f"can't keep compiled code {where}: every process compiles it again; "
        f"set {CACHE_VARIABLE} to a folder that can be written",
        RuntimeWarning,
        stacklevel=3,
    )
