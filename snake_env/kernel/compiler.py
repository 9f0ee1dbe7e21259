"""Turns traces into machine code: a loop over sub-steps in which every operation is a vector.

The code is LLVM IR in which one value holds all lanes of a block (``<8 x double>``), so nothing is
left to a vectoriser's mood. Only strict IEEE operations are used (no contraction, no reassociation):
a lane's result does not depend on the lanes beside it, nor on the machine's vector width.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import struct
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import llvmlite
import llvmlite.binding as llvm
import platformdirs

from snake_env.equations.tracing import Operation, Trace

CACHE_VARIABLE = "SNAKE_ENV_CACHE_DIR"
_log = logging.getLogger(__name__)
_ENGINES: list[llvm.ExecutionEngine] = []
_MACHINE_OPTIONS = {"opt": 2, "reloc": "pic"}
_PASS_OPTIONS = {"speed_level": 1}
_LARGEST_CODE = 64 * 2**20  # bytes; kernels have about a hundredth of it
_COMPARISONS = ("olt", "ole", "ogt", "oge", "oeq")

BlockFunction = Callable[[int, int, int, int, int], None]
"""Addresses of the first block, the constants and the clock's row; sub-steps and blocks to run."""


def emit(loop: Trace, last: Trace, rows: int, running: int, clock_width: int, lanes: int) -> str:
    """LLVM IR of ``run(blocks, constants, clock, n_steps, n_blocks)``.

    For each block, runs ``loop`` once per sub-step until ``n_steps`` are done or no lane is running
    any more, and then ``last`` once.

    Args:
        loop: One sub-step.
        last: What is done after the last sub-step.
        rows: Rows of a block.
        running: The row that is 0 for the lanes that are running.
        clock_width: Numbers in a row of the clock.
        lanes: Lanes in a block.
    """
    vector, align = f"<{lanes} x double>", min(64, 8 * lanes)
    return "\n".join(
        (
            f"declare {vector} @llvm.sqrt.v{lanes}f64({vector})",
            f"declare {vector} @llvm.fabs.v{lanes}f64({vector})",
            "define void @run(ptr noalias %blocks, ptr noalias %shared, ptr noalias %clock,",
            "                 i64 %n_steps, i64 %n_blocks)",
            '    nounwind "prefer-vector-width"="512" "min-legal-vector-width"="512" {',
            "entry:",
            "  %moves = icmp ugt i64 %n_steps, 0",
            "  br label %block",
            "block:",
            "  %b = phi i64 [0, %entry], [%b.next, %last]",
            f"  %b.offset = mul i64 %b, {rows * lanes}",
            "  %lanes = getelementptr double, ptr %blocks, i64 %b.offset",
            "  br i1 %moves, label %loop, label %last",
            "loop:",
            "  %s = phi i64 [0, %block], [%s.next, %loop]",
            f"  %s.offset = mul i64 %s, {clock_width}",
            "  %now = getelementptr double, ptr %clock, i64 %s.offset",
            *_straight_line(loop, "a", lanes),
            f"  %running.p = getelementptr double, ptr %lanes, i64 {running * lanes}",
            f"  %running.v = load {vector}, ptr %running.p, align {align}",
            f"  %running = fcmp oeq {vector} %running.v, zeroinitializer",
            f"  %running.bits = bitcast <{lanes} x i1> %running to i{lanes}",
            f"  %any = icmp ne i{lanes} %running.bits, 0",
            "  %s.next = add i64 %s, 1",
            "  %more = icmp ult i64 %s.next, %n_steps",
            "  %again = and i1 %any, %more",
            "  br i1 %again, label %loop, label %last",
            "last:",
            *_straight_line(last, "z", lanes),
            "  %b.next = add i64 %b, 1",
            "  %left = icmp ult i64 %b.next, %n_blocks",
            "  br i1 %left, label %block, label %exit",
            "exit:",
            "  ret void",
            "}",
        )
    )


def _number(value: float) -> str:
    return "0x" + struct.pack(">d", value).hex().upper()


def _straight_line(trace: Trace, prefix: str, lanes: int) -> list[str]:
    """The trace's instructions, each value named after its position."""
    vector, mask = f"<{lanes} x double>", f"<{lanes} x i1>"
    ones = f"<{', '.join(['i1 true'] * lanes)}>"
    align = min(64, 8 * lanes)  # blocks start at multiples of 64 bytes, rows follow each other
    lines: list[str] = []

    def name(position: int | float) -> str:
        operation = trace.operations[int(position)]
        if operation.name == "number":
            number = _number(float(operation.operands[0]))
            return f"<{', '.join([f'double {number}'] * lanes)}>"
        return f"%{prefix}{int(position)}"

    def scalar(result: str, base: str, row: int) -> None:
        splat = f"<{lanes} x i32> zeroinitializer"
        lines.extend(
            (
                f"  {result}.p = getelementptr double, ptr {base}, i64 {row}",
                f"  {result}.s = load double, ptr {result}.p, align 8",
                f"  {result}.i = insertelement {vector} poison, double {result}.s, i64 0",
                f"  {result} = shufflevector {vector} {result}.i, {vector} poison, {splat}",
            )
        )

    for position, operation in enumerate(trace.operations):
        result = f"%{prefix}{position}"
        kind, operands = operation
        if kind == "number":
            continue
        if kind == "lane":
            lines.append(
                f"  {result}.p = getelementptr double, ptr %lanes, i64 {int(operands[0]) * lanes}"
            )
            lines.append(f"  {result} = load {vector}, ptr {result}.p, align {align}")
        elif kind in ("shared", "clock"):
            scalar(result, "%shared" if kind == "shared" else "%now", int(operands[0]))
        else:
            lines.append(
                f"  {result} = " + _instruction(operation, name, vector, mask, ones, lanes)
            )
    for row, position in trace.stores:
        pointer = f"%{prefix}store{row}"
        lines.append(f"  {pointer} = getelementptr double, ptr %lanes, i64 {row * lanes}")
        lines.append(f"  store {vector} {name(position)}, ptr {pointer}, align {align}")
    return lines


def _instruction(
    operation: Operation,
    name: Callable[[int | float], str],
    vector: str,
    mask: str,
    ones: str,
    lanes: int,
) -> str:
    kind, operands = operation
    values = [name(operand) for operand in operands]
    if kind in ("fadd", "fsub", "fmul", "fdiv"):
        return f"{kind} {vector} {values[0]}, {values[1]}"
    if kind == "fneg":
        return f"fneg {vector} {values[0]}"
    if kind in ("sqrt", "fabs"):
        return f"call {vector} @llvm.{kind}.v{lanes}f64({vector} {values[0]})"
    if kind in _COMPARISONS:
        return f"fcmp {kind} {vector} {values[0]}, {values[1]}"
    if kind in ("and", "or"):
        return f"{kind} {mask} {values[0]}, {values[1]}"
    if kind == "not":
        return f"xor {mask} {values[0]}, {ones}"
    if kind == "select":
        return f"select {mask} {values[0]}, {vector} {values[1]}, {vector} {values[2]}"
    raise AssertionError(f"no instruction for {kind}")


def load(ir: str, what: str) -> BlockFunction:
    """Machine code of ``run`` in the IR: from the cache, or compiled (and announced) and cached.

    Args:
        ir: What :func:`emit` made.
        what: Name of the kernel in the announcement.
    """
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
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
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(hashlib.sha256(code).digest() + code)
        try:
            os.chmod(file.name, 0o644)  # temporary files are their owner's alone
            os.replace(file.name, path)
        except OSError:
            os.unlink(file.name)
            raise
    except OSError as error:
        _warn(f"in {path.parent} ({error.strerror})")


def _warn(where: str) -> None:
    warnings.warn(
        f"can't keep compiled code {where}: every process compiles it again; "
        f"set {CACHE_VARIABLE} to a folder that can be written",
        RuntimeWarning,
        stacklevel=3,
    )
