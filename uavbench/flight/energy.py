"""The power that a quadrotor needs, by its airspeed.

Zeng, Xu, Zhang, "Energy minimization for wireless communication with rotary-wing UAV", IEEE Transactions on Wireless
Communications 2019, eq. 12 and table I: P(V) = P₀ (1 + 3V²/U²) + P₁ (√(1 + V⁴/4v₀⁴) − V²/2v₀²)^½ + ½ d₀ ρ s A V³, the power of
the blades' profile, of the lift, and against the drag of the body. The values are those of the paper's aircraft, whose weight
is 20 N.
"""

import numpy as np
from numpy.typing import NDArray

_PROFILE, _INDUCED = 79.86, 88.63  # W: P₀ and P₁
_TIP, _HOVER = 120.0, 4.03  # m/s: U, the speed of the blades' tips, and v₀, that of the air through the rotor in hovering
_DRAG, _DENSITY, _SOLIDITY, _AREA = 0.6, 1.225, 0.05, 0.503  # d₀, ρ in kg/m³, s, and A in m²


def power(airspeed: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the power in W for airspeeds in m/s."""
    squares = np.asarray(airspeed, dtype=np.float64) ** 2
    profile = _PROFILE * (1 + 3 * squares / _TIP**2)
    induced = _INDUCED * np.sqrt(np.sqrt(1 + squares**2 / (4 * _HOVER**4)) - squares / (2 * _HOVER**2))
    return profile + induced + 0.5 * _DRAG * _DENSITY * _SOLIDITY * _AREA * squares**1.5
