"""numba, typed: the decorators of the kernels, and the exponential their inner loops share.

`kernel` and `parallel_kernel` compile with IEEE arithmetic: what screens non-finite input must see
NaN. `row_kernel` is for loops over the 16 pixels of a row: inlined, and free to reorder sums, so
that they become vector code. That order is fixed when they are compiled, so results do not depend
on the number of threads.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, TypeVar, cast

import numba
from llvmlite import ir  # type: ignore[import-untyped]
from numba.extending import intrinsic, overload

from evogs_codec.common.compiled import jit

__all__ = [
    "POWERS",
    "Scalar",
    "exp2",
    "inlined",
    "kernel",
    "n_threads",
    "parallel_kernel",
    "prange",
    "prefetch",
    "row_kernel",
]

Scalar: TypeAlias = Any  # a number of the type that a kernel is compiled for
Numba: TypeAlias = Any  # an object of the compiler, which has no types
Function = TypeVar("Function", bound=Callable[..., Any])

# How long a thread of GNU OpenMP spins before it sleeps, read when its first kernel runs. Its own
# choice is milliseconds: beside other programs, small pictures then take 40 times as long.
os.environ.setdefault("GOMP_SPINCOUNT", "1000")

_FAST = {"contract", "nsz", "arcp", "reassoc", "nnan"}

prange: Any = numba.prange


def kernel(function: Function) -> Function:
    """Compile `function` for one thread."""
    return cast(Function, jit(error_model="numpy")(function))


def parallel_kernel(function: Function) -> Function:
    """Compile `function`, its `prange` loops over all threads."""
    return cast(Function, jit(parallel=True, error_model="numpy")(function))


def inlined(function: Function) -> Function:
    """Compile `function` into the kernels that call it."""
    return cast(Function, jit(forceinline=True, error_model="numpy")(function))


def row_kernel(function: Function) -> Function:
    """Compile `function` into the kernels that call it, as vector code."""
    return cast(Function, jit(forceinline=True, fastmath=_FAST, error_model="numpy")(function))


def n_threads() -> int:
    """Threads that a parallel kernel runs on.

    Kernels get the number as an argument: numba cannot cache a kernel that asks for it.
    """
    return int(numba.get_num_threads())


@intrinsic  # type: ignore[misc, untyped-decorator, unused-ignore]
def prefetch(_context: Numba, rows: Numba, row: Numba) -> Numba:
    """Ask for the beginning of a row of an array (n, ...), which is read a little later."""

    def generate(context: Numba, builder: Numba, signature: Numba, args: Numba) -> Numba:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        stride = builder.extract_value(array.strides, 0)
        index = builder.sext(args[1], ir.IntType(64)) if args[1].type.width < 64 else args[1]
        byte, word = ir.IntType(8), ir.IntType(32)
        start = builder.bitcast(array.data, byte.as_pointer())
        at = builder.gep(start, [builder.mul(stride, index)])
        kind = ir.FunctionType(ir.VoidType(), [byte.as_pointer(), word, word, word])
        function = builder.module.declare_intrinsic("llvm.prefetch", [byte.as_pointer()], kind)
        builder.call(function, [at, *(ir.Constant(word, k) for k in (0, 3, 1))])
        return context.get_dummy_value()

    return numba.types.void(rows, row), generate


def exp2(t: Scalar, powers: Sequence[Scalar]) -> Scalar:
    """2**t for -126 <= t <= 0, in kernels; float32 to 2e-7 relative, float64 to 1e-14.

    Args:
        t: exponent.
        powers: the first 7 are `POWERS`, of the type of t. They come from an array that a kernel
            gets: literals would be loaded again in each turn of an inner loop, in two instructions.
    """
    # Kernels get the overload below in its place; plain Python never calls it.
    raise NotImplementedError(f"compiled code only: exp2({t}, {powers})")


# 2**f on [-1, 0], highest power first; relative error below 2e-9 (weighted least squares).
POWERS = (
    1.0851056219409133e-4, 1.2730498518184752e-3, 9.577009053460775e-3, 5.548942106099708e-2,
    2.4022396683364336e-1, 6.931470127525523e-1, 0.9999999981437165,
)  # fmt: skip
_LN2 = math.log(2.0)


@intrinsic  # type: ignore[misc, untyped-decorator, unused-ignore]
def _truncate(_context: Numba, x: Numba) -> Numba:
    """int32(x), towards zero."""

    def generate(_context: Numba, builder: Numba, _signature: Numba, args: Numba) -> Numba:
        return builder.fptosi(args[0], ir.IntType(32))

    return numba.types.int32(x), generate


@intrinsic  # type: ignore[misc, untyped-decorator, unused-ignore]
def _scale(_context: Numba, x: Numba, n: Numba) -> Numba:
    """X * 2**n, by adding to the exponent of the float32 x; numba would compute in int64."""

    def generate(_context: Numba, builder: Numba, _signature: Numba, args: Numba) -> Numba:
        word = ir.IntType(32)
        bits = builder.bitcast(args[0], word)
        bits = builder.add(bits, builder.shl(args[1], ir.Constant(word, 23)))
        return builder.bitcast(bits, ir.FloatType())

    return x(x, n), generate


@overload(exp2, jit_options={"forceinline": True, "fastmath": _FAST})  # type: ignore[misc, untyped-decorator, unused-ignore]
def _exp2(t: Numba, powers: Numba) -> Numba:
    if t == numba.types.float32:
        real = numba.types.float32

        def compiled(t: Numba, powers: Numba) -> Numba:
            n = _truncate(t)
            f = t - real(n)
            p = powers[0] * f + powers[1]
            p = p * f + powers[2]
            p = p * f + powers[3]
            p = p * f + powers[4]
            p = p * f + powers[5]
            p = p * f + powers[6]
            return _scale(p, n)

        return compiled

    def exact(t: Numba, powers: Numba) -> Numba:
        return math.exp(t * _LN2)

    return exact
