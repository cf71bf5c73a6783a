"""What one writes with diffrax: one push of one contact by `diffeqsolve` with events.

Equations (1) and (2), a right-hand side and an event for each mode; derivatives in forward
mode through the events. The pusher stops at the first loss of contact.
"""

from __future__ import annotations

import diffrax
import jax
import jax.numpy as jnp
import optimistix as optx

G = 9.80665


def _follow(rates, start, guards, directions, horizon, args):
    """One mode, up to its first event: the state there, and which event it was."""
    events = [lambda t, y, args, g=g, **_: g(y, args) for g in guards]
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: rates(y, args)),
        diffrax.Tsit5(),
        0.0,
        horizon,
        None,
        start,
        args,
        stepsize_controller=diffrax.PIDController(rtol=1e-10, atol=1e-14),
        event=diffrax.Event(events, optx.Newton(1e-12, 1e-14), directions),
        adjoint=diffrax.ForwardMode(),
        max_steps=4096,
        throw=False,
    )
    return solution.ys[-1], solution.event_mask


def push(v, mu_s, k, b, k_v, m, ratio, v_s=None, exponent=None):
    """(F_p, d): d is NaN where the part never leaves.

    `v_s`: Stribeck's speed [m/s]; `exponent`: of a spring k z_r (z / z_r)^n, z_r = 1e-4 m.
    """
    static, kinetic = mu_s * m * G, ratio * mu_s * m * G
    args = (jnp.asarray(v), kinetic)
    period = 2 * jnp.pi * jnp.sqrt(m / k)

    def spring(z):
        if exponent is None:
            return k * z
        return jnp.where(z > 0, k * 1e-4 * (jnp.where(z > 0, z, 1.0) / 1e-4) ** exponent, k * z)

    def drag(u, args):
        bent = 0.0 if v_s is None else (1 / ratio - 1) * jnp.exp(-((u / v_s) ** 2))
        return args[1] * (1 + bent) + k_v * u

    def force(y, args):
        return b * (args[0] - y[1]) + spring(y[0])

    def closing(y, args):
        return jnp.stack([args[0] - y[1], (force(y, args) - drag(y[1], args)) / m])

    def rebounding(y, args):
        return jnp.stack([args[0] - y[1], (spring(y[0]) - drag(y[1], args)) / m])

    def free(y, args):
        return jnp.stack([y[1], -drag(y[1], args) / m])

    def force_rate(y, args):
        return jax.jvp(lambda y: force(y, args), (y,), (closing(y, args),))[1]

    def rate(y, args):
        return args[0] - y[1]

    carried = jnp.maximum(0.0, static - b * v)
    if exponent is None:
        reach = carried / k
    else:
        share = jnp.where(carried > 0, carried, 1.0) / (k * 1e-4)
        reach = jnp.where(carried > 0, 1e-4 * share ** (1 / exponent), 0.0)
    start = jnp.stack([reach, 0.0 * mu_s])
    rises = force_rate(start, args) > 0
    top, _ = _follow(closing, start, [force_rate], [False], period, args)
    top = jnp.where(rises, top, start)
    turned, _ = _follow(closing, top, [rate], [False], period, args)
    guards = [lambda y, args: y[0], rate]
    released, (lost, _) = _follow(rebounding, turned, guards, [False, True], period, args)
    away = jnp.stack([0.0 * mu_s, released[1]])
    longest = 2 * m * released[1] / kinetic
    rest, _ = _follow(free, away, [lambda y, args: y[1]], [False], longest, args)
    return force(top, args), jnp.where(lost, rest[0], jnp.nan)


def with_derivative(v, mu_s, *others, **laws):
    """F_p, d, dF_p/dmu_s, dd/dmu_s."""
    value, slope = jax.jvp(lambda at: push(v, at, *others, **laws), (mu_s,), (jnp.ones_like(mu_s),))
    return jnp.stack([*value, slope[0], jnp.where(jnp.isnan(value[1]), jnp.nan, slope[1])])
