"""Copying short rows in kernels.

A row of a map is 17 to 60 numbers long. For so few numbers, LLVM's vectorised loop spends more time before and after its
vectors than in them. So the vectors are written out here: eight numbers at a time, the last vector overlapping the one before.
"""

from typing import Any, cast

import numpy as np
from llvmlite import ir  # pyright: ignore[reportMissingTypeStubs]
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from uavbench.world.kernel import kernel

_LANES = 8


@intrinsic
def _vector_copier(typing: Any, source: Any, target: Any, start: Any) -> Any:  # noqa: ARG001  # Numba passes it
    """Copy `_LANES` float32 numbers of contiguous arrays, from ``start`` on."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = ir.VectorType(ir.FloatType(), _LANES).as_pointer()
        places: list[Any] = []
        for kind, array in zip(signature.args[:2], arguments[:2], strict=True):
            data = context.make_array(kind)(context, builder, array).data
            places.append(builder.bitcast(builder.gep(data, [arguments[2]]), vector))
        builder.store(builder.load(places[0], align=4), places[1], align=4)
        return context.get_dummy_value()

    return types.void(source, target, types.intp), generate


_copy_vector = cast("Any", _vector_copier)  # Numba calls it without the first argument


@kernel
def copy_row(source: NDArray[np.float32], target: NDArray[np.float32]) -> None:
    """Copy a contiguous row to another of the same length."""
    size = len(target)
    if size < _LANES:
        for x in range(size):
            target[x] = source[x]
        return
    for x in range(0, size - _LANES + 1, _LANES):
        _copy_vector(source, target, x)
    _copy_vector(source, target, size - _LANES)
