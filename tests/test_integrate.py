"""Diffrax against the closed form, against scipy on laws of a user's own, and at its limits."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from difffric.closed_form import ClosedForm
from difffric.contact import AbstractContact
from difffric.errors import InputError
from difffric.friction import AbstractFriction
from difffric.integrate import Diffrax
from difffric.observables import observe
from difffric.pusher import ConstantSpeed
from difffric.rig import Rig, spring_damper_rig

G = 9.80665
NAMES = ("mu_s", "k", "b", "k_v", "mass", "velocity")


class Hertz(AbstractContact):
    """k z^n, with a damper b on approach."""

    k: float
    n: float
    b: float

    def approach(self, z, w):
        return self.k * z**self.n + self.b * w

    def rebound(self, z, w):
        return self.k * z**self.n


class Stribeck(AbstractFriction):
    """mu_k F_N (1 + rise exp(-(u / v_s)^2)) while sliding, mu_k = 0.75 mu_s."""

    mu_s: float
    rise: float
    v_s: float

    def sliding(self, u, F_N):
        return 0.75 * self.mu_s * F_N * (1 + self.rise * jnp.exp(-((u / self.v_s) ** 2)))

    def breakaway(self, F_N):
        return self.mu_s * F_N


def random_rigs(n, seed):
    """n rows of NAMES, and strokes, half of them without one."""
    rng = np.random.default_rng(seed)
    k, mass = 10 ** rng.uniform(5, 6.3, n), rng.uniform(2, 30, n)
    b = 2 * rng.uniform(0.03, 1.1, n) * np.sqrt(k * mass)
    columns = rng.uniform(0.05, 0.3, n), k, b, rng.uniform(0, 60, n), mass
    stroke = np.where(np.arange(n) % 2, rng.uniform(0.5e-3, 2e-3, n), np.inf)
    return np.stack([*columns, rng.uniform(500, 4000, n) / 60e3], axis=1), stroke


def affine_push(point, stroke, integrator):
    mu_s, k, b, k_v, mass, velocity = point
    rig = spring_damper_rig(mass=mass, mu_s=mu_s, k=k, b=b, k_v=k_v, stroke=stroke)
    seen = observe(rig, velocity, integrator)
    return jnp.stack([seen.peak_force, seen.sliding_distance]), seen


def curved_push(point, stroke):
    """A push with Hertz and Stribeck; point: mu_s, rise, v_s, k, n, b, mass, velocity."""
    mu_s, rise, v_s, k, n, b, mass, velocity = point
    rig = Rig(mass, Stribeck(mu_s, rise, v_s), Hertz(k, n, b), ConstantSpeed(stroke))
    seen = observe(rig, velocity)
    return jnp.stack([seen.peak_force, seen.sliding_distance]), seen


@jax.jit
@jax.vmap
def curved_pushes(point, stroke):
    """Observables, and the derivatives of (F_p, d) in mu_s."""

    def at(mu_s):
        return curved_push(point.at[0].set(mu_s), stroke)

    (value, seen), (slope, _) = jax.jvp(at, (point[0],), (jnp.ones(()),))
    return value, slope, seen


def with_jacobian(point, stroke, integrator):
    f = partial(affine_push, stroke=stroke, integrator=integrator)
    J, seen = jax.jacfwd(f, has_aux=True)(point)
    return f(point)[0], J, seen


def test_agrees_with_the_closed_form_in_values_and_derivatives():
    points, strokes = random_rigs(60, seed=3)
    (v_0, J_0, seen_0), (v_1, J_1, seen_1) = (
        jax.jit(jax.vmap(partial(with_jacobian, integrator=integrator)))(points, strokes)
        for integrator in (ClosedForm(), Diffrax())
    )
    for name in ("reason", "regime", "contacts", "kind"):
        np.testing.assert_array_equal(getattr(seen_1, name), getattr(seen_0, name), name)
    assert np.max(seen_0.contacts) >= 3
    assert np.sum(np.isfinite(v_0[:, 1])) > 40
    np.testing.assert_allclose(v_1, v_0, rtol=1e-7)
    # A derivative is compared with the largest of its push: each as d log / d log.
    relative_0, relative_1 = (J * points[:, None, :] / v_0[..., None] for J in (J_0, J_1))
    known = np.isfinite(v_0)
    size = np.max(np.abs(relative_0), axis=-1, keepdims=True)
    np.testing.assert_allclose((relative_1 / size)[known], (relative_0 / size)[known], atol=1e-6)


def reference(point, stroke):
    """(F_p, d, contacts) by DOP853, its modes and events written anew: the dumb reference."""
    mu_s, rise, v_s, k, n, b, mass, v = point

    def friction(u):
        return 0.75 * mu_s * mass * G * (1 + rise * np.exp(-((u / v_s) ** 2)))

    def spring(z):
        return k * np.maximum(z, 0.0) ** n

    F_S = mu_s * mass * G
    stands_at_release = not np.isfinite(stroke)
    t, x, u, v_p, peak, lost_at, contacts = 0.0, 0.0, 0.0, v, 0.0, None, 1
    t_stop = stroke / v
    mode = "stuck"
    for _ in range(200):
        z = min(v * t, stroke) - x if v_p > 0 or not stands_at_release else tip - x
        if mode == "stuck":
            if v_p == 0:
                return peak, np.nan if lost_at is None or z > 0 else x - lost_at, contacts
            z_b = max((F_S - b * v) / k, 0.0) ** (1 / n)
            wait = (z_b - z) / v
            if z < 0 and t + wait <= t_stop:
                contacts, lost_at = contacts + 1, None
            if t + wait > t_stop:
                t, v_p = t_stop, 0.0
                continue
            t, mode = t + wait, "closing"
            continue
        tip_at = (lambda s, y=z + x, t=t, v_p=v_p: y + v_p * (s - t))
        approach = b if mode == "closing" else 0.0
        force = (
            (lambda s, q: 0.0)
            if mode == "free"
            else (lambda s, q: spring(tip_at(s) - q[0]) + approach * (v_p - q[1]))
        )
        events = {
            "w": lambda s, q: v_p - q[1],
            "u": lambda s, q: q[1],
            "z": lambda s, q: tip_at(s) - q[0],
        }
        down, up = -1, 1
        wanted = {
            "closing": [("w", down), ("u", down)],
            "rebounding": [("z", down), ("w", up)],
            "free": [("u", down), ("z", up)],
        }[mode]
        chosen = []
        for name, direction in wanted:
            event = partial(lambda s, q, f: f(s, q), f=events[name])
            event = _event(event, direction)
            chosen.append(event)
        if mode == "closing":  # and the force's summit, not terminal
            slope = lambda s, q: k * n * np.maximum(tip_at(s) - q[0], 0.0) ** (n - 1) * (  # noqa: E731
                v_p - q[1]
            ) - b * (force(s, q) - friction(q[1])) / mass
            chosen.append(_event(slope, down, terminal=False))
        end = t_stop if v_p > 0 and np.isfinite(t_stop) else t + 5.0
        run = solve_ivp(
            lambda s, q: [q[1], (force(s, q) - friction(q[1])) / mass],
            (t, end), [x, u], "DOP853", events=chosen, rtol=1e-12, atol=1e-15, first_step=1e-6,
        )
        if mode == "closing":
            seen = [force(t, (x, u)), force(run.t[-1], run.y[:, -1])]
            seen += [force(s, q) for s, q in zip(run.t_events[-1], run.y_events[-1], strict=True)]
            peak = max(peak, *seen)
        t, (x, u) = run.t[-1], run.y[:, -1]
        if run.status == 0:
            v_p = 0.0
            mode = "rebounding" if mode == "closing" else mode
            continue
        which = next(w for (w, _), ts in zip(wanted, run.t_events, strict=False) if len(ts))
        if mode == "closing":
            mode, u = ("rebounding", v_p) if which == "w" else ("stuck", 0.0)
        elif mode == "rebounding" and which == "z":
            mode, lost_at = "free", x
            if stands_at_release:
                v_p, tip = 0.0, x
        elif mode == "rebounding":
            mode = "closing" if v_p > 0 else "stuck"
        else:
            mode, u = ("stuck", 0.0) if which == "u" else ("closing", u)
            if mode == "closing":
                contacts, lost_at = contacts + 1, None
    raise AssertionError("too many legs")
