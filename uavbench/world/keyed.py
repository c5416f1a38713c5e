"""Random numbers computed from keys instead of drawn from a shared stream.

Source: SplitMix64 (Steele, Lea, Flood, OOPSLA 2014). Its output function is a bijective hash, so that any element of a
stream can be computed without the others. The same key gives the same numbers in any batch, order, worker and process.
"""

import math

import numpy as np
from numpy.typing import NDArray

from uavbench.world.kernel import kernel

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_30, _27, _31, _32, _11, _58 = (np.uint64(n) for n in (30, 27, 31, 32, 11, 58))
_UNIT = 1.0 / 9007199254740992.0  # 2⁻⁵³
_LARGEST = 1.0 - _UNIT

# The purposes of streams: streams of one key with different purposes are independent.
START, CONTENT, NOISE, AGENT, SCATTER, TEAM = (np.uint64(n) for n in (1, 2, 3, 4, 5, 17))  # why 17: ADR 5
CITY = np.uint64(23)


@kernel
def mix(z: np.uint64) -> np.uint64:
    """Hash 64 bits to 64 bits, bijectively."""
    z = np.uint64(z)  # in Python a kernel's result is an int, and may be passed to the next kernel
    z = (z ^ (z >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    return z ^ (z >> _31)


@kernel
def stream(key: np.uint64, purpose: np.uint64) -> np.uint64:
    """Return the state in which the stream of ``key`` for ``purpose`` begins."""
    return mix(mix(np.uint64(key) + _GOLDEN) + np.uint64(purpose) * _GOLDEN)


@kernel
def next_bits(cursor: NDArray[np.uint64]) -> np.uint64:
    """Return the next 64 bits of the stream whose state is ``cursor[0]``, and advance it."""
    cursor[0] += _GOLDEN
    return mix(cursor[0])


@kernel
def next_integer(cursor: NDArray[np.uint64], count: int) -> int:
    """Return an integer uniform in 0, …, ``count`` − 1 (its bias is below ``count`` / 2³²)."""
    return int(((next_bits(cursor) >> _32) * np.uint64(count)) >> _32)


@kernel
def _unit(bits: np.uint64) -> float:
    """Map 64 bits, of which 53 are used, to [0, 1)."""
    return np.float64(np.int64(bits >> _11)) * _UNIT


@kernel
def next_uniform(cursor: NDArray[np.uint64], low: float, high: float) -> float:
    """Return a number uniform in [``low``, ``high``)."""
    return low + (high - low) * _unit(next_bits(cursor))


@kernel
def element(start: np.uint64, index: int) -> np.uint64:
    """Return element ``index``, 64 bits, of the stream that begins in state ``start``."""
    return mix(np.uint64(start) + np.uint64(index) * _GOLDEN)


@kernel
def normal_of(bits: np.uint64) -> float:
    """Map 64 bits to the standard normal distribution, monotonically."""
    p = (np.float64(np.int64(np.uint64(bits) >> _11)) + 0.5) * _UNIT
    return normal_quantile(min(p, _LARGEST))  # the largest of 2⁵³ numbers is rounded to 1, whose quantile is infinite


@kernel
def normal_above(bits: np.uint64) -> float:
    """Return an upper bound of `normal_of` of the same bits, read from a table of 64 values."""
    return _ABOVE[np.uint64(bits) >> _58]


@kernel
def normal(start: np.uint64, index: int) -> float:
    """Return element ``index`` of the standard normal stream that begins in state ``start``."""
    return normal_of(element(start, index))


@kernel
def normal_quantile(p: float) -> float:
    """Return the standard normal quantile of ``p``, 0 < p < 1 (Wichura 1988, algorithm AS 241, PPND16).

    It is three times faster than the Box-Muller transform, because 85 % of the calls need no logarithm.
    """
    centred = p - 0.5
    if abs(centred) <= 0.425:
        return centred * _ratio(_CENTRE, 0.180625 - centred * centred)
    tail = math.sqrt(-math.log(p if centred < 0.0 else 1.0 - p))
    size = _ratio(_SHOULDER, tail - 1.6) if tail <= 5.0 else _ratio(_TAIL, tail - 5.0)
    return -size if centred < 0.0 else size


@kernel
def _ratio(terms: tuple[tuple[float, float], ...], x: float) -> float:
    """Evaluate a ratio of two polynomials in ``x``; ``terms`` are their coefficients from the highest power down."""
    above = below = 0.0
    for a, b in terms:
        above = above * x + a
        below = below * x + b
    return above / below


_CENTRE = (
    (2.5090809287301226727e3, 5.2264952788528545610e3),
    (3.3430575583588128105e4, 2.8729085735721942674e4),
    (6.7265770927008700853e4, 3.9307895800092710610e4),
    (4.5921953931549871457e4, 2.1213794301586595867e4),
    (1.3731693765509461125e4, 5.3941960214247511077e3),
    (1.9715909503065514427e3, 6.8718700749205790830e2),
    (1.3314166789178437745e2, 4.2313330701600911252e1),
    (3.3871328727963666080e0, 1.0),
)
_SHOULDER = (
    (7.74545014278341407640e-4, 1.05075007164441684324e-9),
    (2.27238449892691845833e-2, 5.47593808499534494600e-4),
    (2.41780725177450611770e-1, 1.51986665636164571966e-2),
    (1.27045825245236838258e0, 1.48103976427480074590e-1),
    (3.64784832476320460504e0, 6.89767334985100004550e-1),
    (5.76949722146069140550e0, 1.67638483018380384940e0),
    (4.63033784615654529590e0, 2.05319162663775882187e0),
    (1.42343711074968357734e0, 1.0),
)
_TAIL = (
    (2.01033439929228813265e-7, 2.04426310338993978564e-15),
    (2.71155556874348757815e-5, 1.42151175831644588870e-7),
    (1.24266094738807843860e-3, 1.84631831751005468180e-5),
    (2.65321895265761230930e-2, 7.86869131145613259100e-4),
    (2.96560571828504891230e-1, 1.48753612908506148525e-2),
    (1.78482653991729133580e0, 1.36929880922735805310e-1),
    (5.46378491116411436990e0, 5.99832206555887937690e-1),
    (6.65790464350110377720e0, 1.0),
)

# The quantiles of 1/64, …, 63/64 and of the largest number drawn, plus a margin for rounding errors.
_ABOVE = np.array([normal_quantile(min((n + 1) / 64, _LARGEST)) for n in range(64)]) + 1e-9

#: The coefficients of `normal_quantile`, for implementations in other languages.
QUANTILE = {"centre": _CENTRE, "shoulder": _SHOULDER, "tail": _TAIL}
