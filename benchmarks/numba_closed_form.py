"""The practical limit: one push of one contact, solved on paper and compiled by numba.

Equations (1) and (2) by hand, with their derivatives by mu_s by hand: nothing here can be
exchanged for another law. Underdamped contacts only (NaN else); the pusher stops at the first
loss of contact. Independent of the library's own closed form except for the mathematics.
"""

from __future__ import annotations

from math import atan2, cos, exp, log1p, nan, pi, sin, sqrt

import numpy as np
from numba import njit, prange

G = 9.80665
FAST = {"error_model": "numpy", "fastmath": {"contract", "afn", "nsz", "arcp"}}
"""What was fastest of numba's settings, at no loss of accuracy: a tenth less time."""


@njit(inline="always", **FAST)
def _extremum(alpha, omega0_sq, omega, p, dp, p_mu, dp_mu):
    """First turning point of p'' + 2 alpha p' + omega0^2 p = 0 from p' > 0: p and its derivative.

    With tan(omega t) = omega p' / Q the sine and cosine there are algebra.
    """
    Q = alpha * dp + omega0_sq * p
    radius = sqrt(Q * Q + (omega * dp) ** 2)
    decay = exp(-alpha / omega * atan2(omega * dp, Q))
    c, s = decay * Q / radius, decay * dp / radius
    return p * c + (dp + alpha * p) * s, p_mu * (c + alpha * s) + dp_mu * s


@njit(inline="always", **FAST)
def _rest(u, drag, rate):
    """Distance from the speed u to rest under u' = -(drag + rate u); its derivatives by u, drag."""
    y = rate * u / drag
    if abs(y) < 0.03:
        h = 1 / 13.0
        for n in range(12, 1, -1):
            h = 1.0 / n - y * h
    else:
        h = (y - log1p(y)) / (y * y)
    return u * u / drag * h, u / (drag + rate * u), -((u / drag) ** 2) * (1.0 / (1.0 + y) - h)


@njit(**FAST)
def push(v, mu_s, k, b, k_v, m, ratio):
    """(F_p, d, dF_p/dmu_s, dd/dmu_s); d is NaN where the part never leaves."""
    F_N = m * G
    omega0_sq = k / m
    alpha = 0.5 * (b + k_v) / m
    discriminant = omega0_sq - alpha * alpha
    if discriminant <= 0:
        return nan, nan, nan, nan
    omega = sqrt(discriminant)

    # Stuck, until the contact overcomes mu_s F_N; then closing, from the speed v to z' = 0.
    z_e, z_e_mu = (ratio * mu_s * F_N + k_v * v) / k, ratio * F_N / k
    xi, xi_mu = -z_e, -z_e_mu
    F_p, F_p_mu = b * v, 0.0
    if mu_s * F_N > b * v:
        xi += (mu_s * F_N - b * v) / k
        xi_mu += F_N / k
        F_p, F_p_mu = mu_s * F_N, F_N
    turned, turned_mu = _extremum(alpha, omega0_sq, omega, xi, v, xi_mu, 0.0)

    # The contact force obeys the same oscillator, about k z_e.
    N, N_mu = k * xi + b * v, k * xi_mu
    dN = k * v - b * (2 * alpha * v + omega0_sq * xi)
    if dN > 0:
        top, top_mu = _extremum(alpha, omega0_sq, omega, N, dN, N_mu, -b * omega0_sq * xi_mu)
        F_p, F_p_mu = k * z_e + top, k * z_e_mu + top_mu

    # Rebounding on the spring alone, from z' = 0 until z = 0.
    alpha = 0.5 * k_v / m
    omega = sqrt(omega0_sq - alpha * alpha)
    if turned * exp(-alpha * pi / omega) < z_e:
        return F_p, nan, F_p_mu, nan
    sharp = alpha / omega
    lo, hi = 0.0, pi / omega
    cosine = -z_e / turned
    sine = sqrt(max(1.0 - cosine * cosine, 1e-30))
    angle = pi - atan2(sine, -cosine)
    t = min(hi, (angle + sharp * (1.0 - (pi - angle) * cosine / -sine)) / omega)
    for _ in range(100):
        decay, si = exp(-alpha * t), sin(omega * t)
        shape = decay * (cos(omega * t) + sharp * si)
        w = -turned * omega0_sq / omega * decay * si
        value = z_e + turned * shape
        if value > 0:
            lo = t
        else:
            hi = t
        step = value / w if w != 0 else 0.0
        new = t - step
        if abs(step) <= 1e-9 * t:
            # After this step another one is below rounding; w follows it to first order.
            w -= step * (-2 * alpha * w - omega0_sq * (value - z_e))
            break
        t = new if lo <= new <= hi else 0.5 * (lo + hi)
    t_mu = -(z_e_mu - turned_mu * z_e / turned) / w
    u = v - w
    u_mu = -(w / turned * turned_mu + (-2 * alpha * w + omega0_sq * z_e) * t_mu)

    drag = ratio * mu_s * G
    d, d_u, d_drag = _rest(u, drag, k_v / m)
    return F_p, d, F_p_mu, d_u * u_mu + d_drag * ratio * G


@njit(**FAST)
def batch(v, mu_s, k, b, k_v, m, ratio):
    """`push` for arrays of v and mu_s, on one thread: an array of four rows."""
    out = np.empty((4, v.size))
    for i in range(v.size):
        out[0, i], out[1, i], out[2, i], out[3, i] = push(v[i], mu_s[i], k, b, k_v, m, ratio)
    return out


@njit(parallel=True, **FAST)
def batch_parallel(v, mu_s, k, b, k_v, m, ratio):
    """`batch` on all cores."""
    out = np.empty((4, v.size))
    for i in prange(v.size):
        out[0, i], out[1, i], out[2, i], out[3, i] = push(v[i], mu_s[i], k, b, k_v, m, ratio)
    return out
