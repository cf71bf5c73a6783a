"""What one writes with CasADi: the push of `numba_closed_form` in symbols, derivatives by its AD.

Newton's iteration for the release is written out: CasADi's scalar symbols (SX), its fastest, have
no loops. Four steps, unbracketed, reach the last digit at the 10 000 pushes of the benchmarks; of
100 000 some part so narrowly that it takes eight. Underdamped contacts only.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

G = 9.80665
NEWTON = 4


def _extremum(alpha, omega0_sq, omega, p, dp):
    """First turning point of p'' + 2 alpha p' + omega0^2 p = 0 from p' > 0."""
    Q = alpha * dp + omega0_sq * p
    decay = ca.exp(-alpha / omega * ca.atan2(omega * dp, Q))
    return decay * ca.sqrt(Q**2 + (omega * dp) ** 2) / ca.sqrt(omega0_sq) / ca.sqrt(omega0_sq)


def _rest(u, drag, rate):
    """Distance from the speed u to rest under u' = -(drag + rate u)."""
    y = rate * u / drag
    series = 1 / 13.0
    for n in range(12, 1, -1):
        series = 1.0 / n - y * series
    small = ca.fabs(y) < 0.03
    safe = ca.if_else(small, 1.0, y)
    return u**2 / drag * ca.if_else(small, series, (safe - ca.log1p(safe)) / safe**2)


def push(v, mu_s, k, b, k_v, m, ratio):
    """(F_p, d, whether the part leaves) as expressions; d means nothing where it does not."""
    F_N = m * G
    omega0_sq = k / m
    alpha = 0.5 * (b + k_v) / m
    omega = ca.sqrt(omega0_sq - alpha**2)

    # Stuck, until the contact overcomes mu_s F_N; then closing, from the speed v to z' = 0.
    z_e = (ratio * mu_s * F_N + k_v * v) / k
    stuck = mu_s * F_N > b * v
    xi = ca.if_else(stuck, (mu_s * F_N - b * v) / k, 0.0) - z_e
    turned = _extremum(alpha, omega0_sq, omega, xi, v)

    # The contact force obeys the same oscillator, about k z_e.
    N, dN = k * xi + b * v, k * v - b * (2 * alpha * v + omega0_sq * xi)
    top = _extremum(alpha, omega0_sq, omega, N, dN)
    F_p = ca.if_else(dN > 0, k * z_e + top, ca.if_else(stuck, mu_s * F_N, b * v))

    # Rebounding on the spring alone, from z' = 0 until z = 0.
    alpha = 0.5 * k_v / m
    omega = ca.sqrt(omega0_sq - alpha**2)
    sharp = alpha / omega
    cosine = -ca.fmin(z_e / turned, 1.0)
    sine = ca.sqrt(ca.fmax(1.0 - cosine**2, 1e-30))
    angle = ca.pi - ca.atan2(sine, -cosine)
    t = (angle + sharp * (1.0 - (ca.pi - angle) * cosine / -sine)) / omega
    for _ in range(NEWTON):
        decay, si = ca.exp(-alpha * t), ca.sin(omega * t)
        value = z_e + turned * decay * (ca.cos(omega * t) + sharp * si)
        t = t + value * omega / (turned * omega0_sq * decay * si)
    w = -turned * omega0_sq / omega * ca.exp(-alpha * t) * ca.sin(omega * t)
    d = _rest(v - w, ratio * mu_s * G, k_v / m)
    leaves = turned * ca.exp(-alpha * ca.pi / omega) >= z_e
    return F_p, d, leaves


def function(compiled: bool = False) -> ca.Function:
    """(F_p, d, dF_p/dmu_s, dd/dmu_s) of (v, mu_s, k, b, k_v, m, ratio).

    `compiled`: as C, by the compiler that stands ready (`gcc -O3`), instead of CasADi's own
    virtual machine.
    """
    arguments = ca.SX.sym("arguments", 7)
    F_p, d, leaves = push(*ca.vertsplit(arguments))
    values = ca.vertcat(F_p, d)
    along = ca.DM([0, 1, 0, 0, 0, 0, 0])
    slopes = ca.jtimes(values, arguments, along)
    options = {}
    if compiled:
        flags = {"compiler": "gcc", "flags": ["-O3", "-march=native"]}
        options = {"jit": True, "compiler": "shell", "jit_options": flags}
    d, dd = (ca.if_else(leaves, x, ca.DM.nan()) for x in (d, slopes[1]))
    return ca.Function("push", [arguments], [ca.vertcat(F_p, d, slopes[0], dd)], options)


def batch(v, mu_s, others, threads: int, compiled: bool = False):
    """A call that gives four rows for arrays of v and mu_s, by so many threads."""
    n = len(v)
    one = function(compiled)
    many = one.map(n, "thread", threads) if threads > 1 else one.map(n)
    table = np.empty((7, n), order="F")
    table[0], table[1] = v, mu_s
    table[2:] = np.array(others)[:, None]
    # CasADi works in place on buffers: nothing is copied or converted within the timing.
    out = np.empty((4, n), order="F")
    buffer, run = many.buffer()
    buffer.set_arg(0, memoryview(table.T))
    buffer.set_res(0, memoryview(out.T))

    def call():
        run()
        return out

    call.keep = buffer, table  # type: ignore[attr-defined]
    return call
