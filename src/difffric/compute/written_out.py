"""sin, cos, atan2 and log1p written out in plain arithmetic for JAX, to 1 to 3 units in the last
place.

XLA's CPU backend calls the C library for these in float64, an element at a time: 2 to 11 ns
each, and a loop that holds one such call is not vectorised at all. Written out they cost what
their additions and multiplications do, eight at a time with AVX-512.

Coefficients of the arctangent and the logarithm, and the reductions, are those of fdlibm (Sun
Microsystems, 1993: `s_atan.c`, `s_log1p.c`, `e_rem_pio2.c`), without its branches. Derivatives
are the exact ones, of every order.
"""

from __future__ import annotations

from functools import partial
from math import factorial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from difffric.compute.arrays import polynomial

Values = Float[Array, "*shape"]
"""One number or many: every function here works on each of them."""

_PI = (3.14159265346825122834, 1.21542010126079320e-10, 4.04453249759190126e-21)
"""pi as a sum; the first two have 33 bits, so that a product with n/2, n < 2^20, is exact."""
_SIN = [(-1.0) ** n / factorial(2 * n + 1) for n in range(1, 11)]
_ATAN = (
    3.33333333333329318027e-01,
    -1.99999999998764832476e-01,
    1.42857142725034663711e-01,
    -1.11111104054623557880e-01,
    9.09088713343650656196e-02,
    -7.69187620504482999495e-02,
    6.66107313738753120669e-02,
    -5.83357013379057348645e-02,
    4.97687799461593236017e-02,
    -3.65315727442169155270e-02,
    1.62858201153657823623e-02,
)
"""Coefficients of the arctangent up to pi/8 and beyond, as fdlibm has them (`s_atan.c`)."""
_LOG = (
    6.666666666666735130e-01,
    3.999999999940941908e-01,
    2.857142874366239149e-01,
    2.222219843214978396e-01,
    1.818357216161805012e-01,
    1.531383769920937332e-01,
    1.479819860511658591e-01,
)
"""Coefficients of the logarithm, as fdlibm has them (`s_log1p.c`)."""
_LN_2 = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
"""ln 2 as a sum; the first has 32 bits, so that its product with an exponent is exact."""
_PI_4_LOW = 3.061616997868382943e-17
"""What pi/4 is more than its float64."""
_TAN_PI_8 = 0.41421356237309503
"""Where the arctangent is pi/8."""
_ONE, _SQRT_HALF, _FRACTION = 0x3FF0000000000000, 0x3FE6A09E667F3BCD, 0x000FFFFFFFFFFFFF
"""The bits of 1 and of sqrt(1/2), and the mask of a mantissa."""


@jax.custom_jvp
def sin_cos(x: Values) -> tuple[Values, Values]:
    """(sin x, cos x) for |x| below 1e6; beyond it, finite numbers that mean nothing.

    The cosine is a sine from the middle between two of its roots: XLA evaluates the two apart.
    """
    k = jnp.round(x * (1 / jnp.pi))
    m = jnp.floor(x * (1 / jnp.pi))
    return _alternating(k) * _half_wave(x, k), -_alternating(m) * _half_wave(x, m + 0.5)


def _half_wave(x, n):
    """sin(x - n pi), where that is from -pi/2 to pi/2."""
    r = ((x - n * _PI[0]) - n * _PI[1]) - n * _PI[2]
    z = r * r
    return r + r * z * polynomial(_SIN, z)


def _alternating(n):
    """(-1)^n."""
    return 1.0 - 2.0 * (n - 2.0 * jnp.floor(0.5 * n))


@sin_cos.defjvp
def _sin_cos_jvp(primals, tangents):
    s, c = sin_cos(*primals)
    return (s, c), (c * tangents[0], -s * tangents[0])


@jax.custom_jvp
def angle(y: Values, x: Values) -> Values:
    """atan2(y, x), from -pi to pi; 0 at the origin."""
    a, b = jnp.abs(x), jnp.abs(y)
    low, high = jnp.minimum(a, b), jnp.maximum(a, b)
    steep = low > _TAN_PI_8 * high  # beyond pi/8: counted from pi/4
    top, bottom = jnp.where(steep, low - high, low), jnp.where(steep, low + high, high)
    q = top / jnp.where(bottom == 0, 1.0, bottom)
    z = q * q
    turn = q - q * z * polynomial(_ATAN, z)
    turn = jnp.where(steep, jnp.pi / 4 + (turn + _PI_4_LOW), turn)
    turn = jnp.where(b > a, jnp.pi / 2 - (turn - 2 * _PI_4_LOW), turn)
    turn = jnp.where(x < 0, jnp.pi - (turn - 4 * _PI_4_LOW), turn)
    return jnp.where(y < 0, -turn, turn)


@angle.defjvp
def _angle_jvp(primals, tangents):
    (y, x), (dy, dx) = primals, tangents
    square = x * x + y * y
    return angle(y, x), (x * dy - y * dx) / jnp.where(square == 0, 1.0, square)


@jax.custom_jvp
def log1p(x: Values) -> Values:
    """ln(1 + x) for x >= 0, infinity included."""
    u = 1.0 + x
    bits = lax.bitcast_convert_type(u, jnp.int64) + (_ONE - _SQRT_HALF)
    k = (bits >> 52) - 1023
    mantissa = lax.bitcast_convert_type((bits & _FRACTION) + _SQRT_HALF, float)
    # For k = 0 what is left is x itself, unrounded; else the rounding of 1 + x is small beside ln.
    f = jnp.where(k == 0, x, mantissa - 1.0)
    s = f / (2.0 + f)
    z = s * s
    half = 0.5 * f * f
    rest = s * (half + z * polynomial(_LOG, z))
    k = k.astype(float)
    log = k * _LN_2[0] - ((half - (rest + k * _LN_2[1])) - f)
    return jnp.where(x == jnp.inf, x, log)


@log1p.defjvp
def _log1p_jvp(primals, tangents):
    (x,), (dx,) = primals, tangents
    return log1p(x), dx / (1.0 + x)


@jax.custom_jvp
def quotient(x: Any, y: Values) -> Values:
    """x / y, whose derivative takes one more division, where JAX's own takes two."""
    return x / y


@partial(quotient.defjvp, symbolic_zeros=True)
def _quotient_jvp(primals, tangents):
    (x, y), (dx, dy) = primals, tangents
    q = quotient(x, y)
    if isinstance(dy, SymbolicZero):
        return q, quotient(dx, y)
    fall = -q * dy
    return q, quotient(fall if isinstance(dx, SymbolicZero) else dx + fall, y)
