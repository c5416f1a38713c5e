"""Copying short rows in kernels, and turning rows of small whole numbers into float32.

A row of a map is 17 to 60 numbers long. For so few numbers, LLVM's vectorised loop spends more time before and after its
vectors than in them. So the vectors are written out here: eight numbers at a time, the last vector overlapping the one before.
"""

from typing import Any, cast

import numpy as np
from llvmlite import ir  # pyright: ignore[reportMissingTypeStubs]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from uavbench.world.kernel import kernel

#: How many bits of a byte `split_block` writes.
BITS = 3
_LANES = 8
_VECTOR = ir.VectorType(ir.FloatType(), _LANES)
_WIDE = 4  # bytes of an integer that a processor turns into a float32


@intrinsic
def _vector_copier(typing: Any, source: Any, first: Any, target: Any, start: Any) -> Any:  # noqa: ARG001  # Numba passes it
    """Copy `_LANES` float32 numbers of a contiguous array, from ``first`` on, and write them from ``start`` on."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = _VECTOR.as_pointer()
        places: list[Any] = []
        for k in (0, 2):
            data = context.make_array(signature.args[k])(context, builder, arguments[k]).data
            places.append(builder.bitcast(builder.gep(data, [arguments[k + 1]]), vector))
        builder.store(builder.load(places[0], align=4), places[1], align=4)
        return context.get_dummy_value()

    return types.void(source, types.intp, target, types.intp), generate


def _divided(builder: Any, numbers: Any, divisors: Any) -> Any:
    """Divide vectors without the processor's slow division.

    The product with the reciprocal is corrected by what it leaves of the number (Markstein 1990). For whole numbers up to the
    divisor, which is a square, the quotient is the correctly rounded one: `tests/simulation/test_rows.py` tries them all.
    """
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
    fma = cast("Any", cgutils).get_or_insert_function(builder.module, kind, f"llvm.fma.v{_LANES}f32")
    reciprocal = builder.fdiv(ir.Constant(_VECTOR, [1.0] * _LANES), divisors)  # the compiler takes it out of the loops
    quotient = builder.fmul(numbers, reciprocal)
    left = builder.call(fma, [builder.fneg(quotient), divisors, numbers])
    return builder.call(fma, [left, reciprocal, quotient])


@intrinsic
def _vector_divider(typing: Any, source: Any, first: Any, target: Any, start: Any, divisor: Any) -> Any:  # noqa: ARG001
    """Divide `_LANES` whole numbers of a contiguous array, from ``first`` on, and write them from ``start`` on as float32.

    The numbers are below 2³¹.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        read, written = (context.make_array(signature.args[k])(context, builder, arguments[k]).data for k in (0, 2))
        kind = ir.VectorType(context.get_data_type(signature.args[0].dtype), _LANES)
        place = builder.bitcast(builder.gep(read, [arguments[1]]), kind.as_pointer())
        width = context.get_abi_sizeof(context.get_data_type(signature.args[0].dtype))
        loaded = builder.load(place, align=width)
        wide = builder.zext(loaded, ir.VectorType(ir.IntType(32), _LANES)) if width < _WIDE else loaded
        lanes: Any = cast("Any", ir.Constant)(_VECTOR, cast("Any", ir).Undefined)
        for lane in range(_LANES):
            lanes = builder.insert_element(lanes, arguments[4], ir.Constant(ir.IntType(32), lane))
        numbers = _divided(builder, builder.sitofp(wide, _VECTOR), lanes)
        out = builder.bitcast(builder.gep(written, [arguments[3]]), _VECTOR.as_pointer())
        builder.store(numbers, out, align=4)
        return context.get_dummy_value()

    return types.void(source, types.intp, target, types.intp, divisor), generate


@intrinsic
def _vector_splitter(typing: Any, source: Any, first: Any, target: Any, start: Any, step: Any) -> Any:  # noqa: ARG001
    """Write the three lowest bits of `_LANES` bytes of a contiguous array, from ``first`` on, as float32.

    The lowest bits are written from ``start`` on, and those of each higher place ``step`` numbers later.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        read, written = (context.make_array(signature.args[k])(context, builder, arguments[k]).data for k in (0, 2))
        wide, bytes_ = ir.VectorType(ir.IntType(32), _LANES), ir.VectorType(ir.IntType(8), _LANES)
        place = builder.bitcast(builder.gep(read, [arguments[1]]), bytes_.as_pointer())
        loaded = builder.zext(builder.load(place, align=1), wide)
        start = arguments[3]
        for bit in range(BITS):
            shifted = builder.lshr(loaded, ir.Constant(wide, [bit] * _LANES))
            numbers = builder.sitofp(builder.and_(shifted, ir.Constant(wide, [1] * _LANES)), _VECTOR)
            out = builder.bitcast(builder.gep(written, [start]), _VECTOR.as_pointer())
            builder.store(numbers, out, align=4)
            start = builder.add(start, arguments[4])
        return context.get_dummy_value()

    return types.void(source, types.intp, target, types.intp, types.intp), generate


_copy_vector = cast("Any", _vector_copier)  # Numba calls it without the first argument
_divide_vector = cast("Any", _vector_divider)
_split_vector = cast("Any", _vector_splitter)


@kernel
def copy_block(
    source: NDArray[np.float32],
    first: int,
    source_step: int,
    target: NDArray[np.float32],
    start: int,
    target_step: int,
    shape: tuple[int, int],
) -> None:
    """Copy a block of numbers.

    ``source`` and ``target`` are flattened: the block's first row begins at ``first`` and at ``start``, and each further row
    begins ``source_step`` and ``target_step`` numbers after the row before. To pass slices would take longer than to copy.
    """
    rows, cols = shape
    for _ in range(rows):
        if cols < _LANES:
            for x in range(cols):
                target[start + x] = source[first + x]
        else:
            for x in range(0, cols - _LANES + 1, _LANES):
                _copy_vector(source, first + x, target, start + x)
            _copy_vector(source, first + cols - _LANES, target, start + cols - _LANES)
        first += source_step
        start += target_step


@kernel
def divide_block(
    source: NDArray[Any],
    first: int,
    source_step: int,
    target: NDArray[np.float32],
    start: int,
    target_step: int,
    shape: tuple[int, int],
    divisor: np.float32,
) -> None:
    """Write a block of whole numbers, divided by ``divisor``, as float32: see `copy_block`."""
    rows, cols = shape
    for _ in range(rows):
        if cols < _LANES:
            for x in range(cols):
                target[start + x] = np.float32(source[first + x]) / divisor
        else:
            for x in range(0, cols - _LANES + 1, _LANES):
                _divide_vector(source, first + x, target, start + x, divisor)
            _divide_vector(source, first + cols - _LANES, target, start + cols - _LANES, divisor)
        first += source_step
        start += target_step


@kernel
def split_block(
    source: NDArray[np.uint8],
    first: int,
    source_step: int,
    target: NDArray[np.float32],
    start: int,
    rows: int,
    cols: int,
) -> None:
    """Write the three lowest bits of a block of bytes as float32, as three blocks that follow each other: see `copy_block`.

    The rows of a block in ``target`` follow each other, too.
    """
    step = rows * cols
    for _ in range(rows):
        if cols < _LANES:
            for x in range(cols):
                for bit in range(BITS):
                    target[start + bit * step + x] = np.float32((source[first + x] >> bit) & 1)
        else:
            for x in range(0, cols - _LANES + 1, _LANES):
                _split_vector(source, first + x, target, start + x, step)
            _split_vector(source, first + cols - _LANES, target, start + cols - _LANES, step)
        first += source_step
        start += cols


@kernel
def fill_range(target: NDArray[np.float32], start: int, stop: int, value: np.float32) -> None:
    """Set the numbers from ``start`` to ``stop`` − 1 of a contiguous array to ``value``."""
    for x in range(start, stop):
        target[np.uint64(x)] = value
