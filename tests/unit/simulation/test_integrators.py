"""Both integrators against the closed form, against scipy on laws of a user's own, and at their
limits."""

from functools import partial

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from difffric.errors import InputError
from difffric.rig import catalogue, parameters
from difffric.rig.contact import AbstractContact
from difffric.rig.friction import AbstractFriction
from difffric.rig.pusher import ConstantSpeed
from difffric.rig.rig import Rig, spring_damper_rig
from difffric.simulation.closed_form import ClosedForm
from difffric.simulation.diffrax_reference import Diffrax
from difffric.simulation.events import Reason
from difffric.simulation.observables import observe, observe_steps
from difffric.simulation.stepping.integrator import RungeKutta
from tests.effect_rigs import OPTIONS

G = 9.80665
# The part halts on the tip for a moment: u falls just below zero and back within one step.
# mu_s, k, b, k_v, mass, velocity, stroke; by bisection of the closed form, 1e-6 beyond the edge.
BRIEF_HALTS = np.array(
    [
        [0.28383202, 365600.0, 109.8, 37.54, 27.37, 0.0135, 0.00116],
        [0.27564367, 363100.0, 232.8, 47.26, 25.76, 0.009163, 0.001176],
        [0.22347683, 162800.0, 80.81, 44.55, 13.15, 0.00755, 0.00136],
    ]
)

INTEGRATORS, NAMES = (Diffrax(), RungeKutta()), ("Diffrax", "RungeKutta")


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


def compiled(function, integrator):
    """jax.jit; with RungeKutta, whose program is the largest, compiled quickly and run slowly."""
    large = isinstance(integrator, RungeKutta)
    return jax.jit(function, compiler_options=OPTIONS if large else None)


def random_rigs(n, seed):
    """n rows of (mu_s, k, b, k_v, mass, velocity), and strokes, half of them without one."""
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


def curved_push(point, stroke, integrator):
    """A push with Hertz and Stribeck; point: mu_s, rise, v_s, k, n, b, mass, velocity."""
    mu_s, rise, v_s, k, n, b, mass, velocity = point
    rig = Rig(mass, Stribeck(mu_s, rise, v_s), Hertz(k, n, b), ConstantSpeed(stroke))
    seen = observe(rig, velocity, integrator)
    return jnp.stack([seen.peak_force, seen.sliding_distance]), seen


@partial(jax.jit, static_argnums=2)
@partial(jax.vmap, in_axes=(0, 0, None))
def curved_pushes(point, stroke, integrator):
    """Observables, and the derivatives of (F_p, d) in mu_s."""

    def at(mu_s):
        return curved_push(point.at[0].set(mu_s), stroke, integrator)

    (value, seen), (slope, _) = jax.jvp(at, (point[0],), (jnp.ones(()),))
    return value, slope, seen


def with_jacobian(point, stroke, integrator):
    def f(point):
        value, seen = affine_push(point, stroke, integrator)
        return value, (value, seen)

    J, (value, seen) = jax.jacfwd(f, has_aux=True)(point)
    return value, J, seen


@pytest.fixture(scope="module")
def followed():
    """Points, and (value, Jacobian, observables) by the closed form and by each integrator."""
    points, strokes = random_rigs(60, seed=3)
    points = np.concatenate([points, BRIEF_HALTS[:, :6]])
    strokes = np.concatenate([strokes, BRIEF_HALTS[:, 6]])
    answers = [
        compiled(jax.vmap(partial(with_jacobian, integrator=integrator)), integrator)(
            points, strokes
        )
        for integrator in (ClosedForm(), *INTEGRATORS)
    ]
    return points, *answers


@pytest.mark.parametrize("which", [0, 1], ids=NAMES)
def test_goes_the_way_of_the_closed_form(followed, which):
    _, (_, _, exact), *integrated = followed
    _, _, ours = integrated[which]
    for name in ("reason", "regime", "contacts", "kind"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(exact, name), name)
    assert np.max(exact.contacts) >= 3


@pytest.mark.parametrize("which", [0, 1], ids=NAMES)
def test_agrees_with_the_closed_form_in_values_and_derivatives(followed, which):
    points, exact, *integrated = jax.tree.map(lambda rows: rows[: -len(BRIEF_HALTS)], followed)
    (v_0, J_0, _), (v_1, J_1, _) = exact, integrated[which]
    known = np.isfinite(v_0)
    assert np.sum(known[:, 1]) > 40
    np.testing.assert_allclose(v_1, v_0, rtol=1e-7)
    # d log / d log, in units of the largest of its push.
    relative_0, relative_1 = (J * points[:, None, :] / v_0[..., None] for J in (J_0, J_1))
    size = np.max(np.abs(relative_0), axis=-1, keepdims=True)
    np.testing.assert_allclose((relative_1 / size)[known], (relative_0 / size)[known], atol=1e-6)


def dop853_leg(mode, laws, t, y, x, u, v_p, until):
    """One leg by scipy: its end, the name of its event (None: `until`) and its highest force."""
    spring, stiffness, b, friction, mass = laws

    def z(s, q):
        return y + v_p * (s - t) - q[0]

    def force(s, q):
        damper = b * (v_p - q[1]) if mode == "closing" else 0.0
        return 0.0 if mode == "free" else spring(z(s, q)) + damper

    def acceleration(s, q):
        return (force(s, q) - friction(q[1])) / mass

    def rise(s, q):
        return stiffness(z(s, q)) * (v_p - q[1]) - b * acceleration(s, q)

    def event(f, direction, terminal=True):
        def g(s, q):
            return f(s, q)

        g.direction, g.terminal = direction, terminal
        return g

    level = event(lambda s, q: v_p - q[1], -1 if mode == "closing" else 1)
    rest = event(lambda s, q: q[1], -1)
    names, events = {
        "closing": (("w", "u"), (level, rest, event(rise, -1, terminal=False))),
        "rebounding": (("w", "z"), (level, event(z, -1))),
        "free": (("u", "z"), (rest, event(z, 1))),
    }[mode]
    run = solve_ivp(
        lambda s, q: (q[1], acceleration(s, q)),
        (t, until),
        (x, u),
        "DOP853",
        events=events,
        rtol=1e-12,
        atol=1e-15,
    )
    seen = [(t, (x, u)), (run.t[-1], run.y[:, -1])]
    if mode == "closing":
        seen += zip(run.t_events[2], run.y_events[2], strict=True)
    fired = [name for name, times in zip(names, run.t_events, strict=False) if len(times)]
    return run.t[-1], *run.y[:, -1], *(fired or [None]), max(force(s, q) for s, q in seen)


def reference(point, stroke):
    """(F_p, d, contacts) of `curved_push` with modes and events written anew."""
    mu_s, rise, v_s, k, n, b, mass, v = point
    laws = (
        lambda z: k * max(z, 0.0) ** n,
        lambda z: k * n * max(z, 0.0) ** (n - 1),
        b,
        lambda u: 0.75 * mu_s * mass * G * (1 + rise * np.exp(-((u / v_s) ** 2))),
        mass,
    )
    z_b = (max(mu_s * mass * G - b * v, 0.0) / k) ** (1 / n)
    t = y = x = u = peak = 0.0
    v_p, t_stop, mode, lost, contacts = v, stroke / v, "stuck", None, 1
    while mode != "stuck" or v_p > 0:
        if mode == "stuck":
            wait = (z_b - (y - x)) / v
            assert wait < t_stop - t, "a push that ends stuck on the tip is not in this test"
            if y < x:
                contacts, lost = contacts + 1, None
            t, y, mode = t + wait, y + v * wait, "closing"
            continue
        until = t_stop if v_p > 0 and np.isfinite(t_stop) else t + 5.0
        t_1, x, u, fired, highest = dop853_leg(mode, laws, t, y, x, u, v_p, until)
        y, t, peak = y + v_p * (t_1 - t), t_1, max(peak, highest)
        if fired is None:
            v_p, mode = 0.0, "rebounding" if mode == "closing" else mode
        elif fired == "u":
            u, mode = 0.0, "stuck"
        elif fired == "w":
            u = v_p
            mode = "rebounding" if mode == "closing" else "closing" if v_p > 0 else "stuck"
        elif mode == "rebounding":
            x, lost, mode = y, x, "free"
            v_p = v_p if np.isfinite(stroke) else 0.0
        else:
            x, lost, mode, contacts = y, None, "closing", contacts + 1
    return peak, np.nan if lost is None else x - lost, contacts


def curved_points():
    """Rows of (mu_s, rise, v_s, k, n, b, mass, velocity), and strokes."""
    rng = np.random.default_rng(8)
    count = 10
    columns = (
        rng.uniform(0.1, 0.2, count),
        rng.uniform(0.1, 0.3, count),
        rng.uniform(0.02, 0.08, count),
        10 ** rng.uniform(8.0, 8.6, count),
        np.full(count, 1.5),
        rng.uniform(0, 900, count),
        rng.uniform(8, 20, count),
        rng.uniform(1000, 3000, count) / 60e3,
    )
    return np.stack(columns, axis=1), np.where(np.arange(count) % 2, 1.5e-3, np.inf)


@pytest.fixture(scope="module")
def expected():
    """((F_p, d, contacts), derivatives of (F_p, d) in mu_s by differences) of each push."""
    weights = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
    found = []
    for point, stroke in zip(*curved_points(), strict=True):
        h = 1e-3 * point[0]
        moved = {j: reference((point[0] + j * h, *point[1:]), stroke)[:2] for j in weights}
        slope = sum(w / h * np.array(moved[j]) for j, w in weights.items())
        found.append((reference(point, stroke), slope))
    return found


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=NAMES)
def test_agrees_with_scipy_on_a_users_own_laws(integrator, expected):
    points, strokes = curved_points()
    value, slope, seen = curved_pushes(points, strokes, integrator)
    assert np.isfinite(value).all() and np.max(seen.contacts) >= 2
    np.testing.assert_array_equal(seen.contacts, [answer[2] for answer, _ in expected])
    np.testing.assert_allclose(value, [answer[:2] for answer, _ in expected], rtol=1e-7)
    np.testing.assert_allclose(slope, [slope for _, slope in expected], rtol=2e-6)


def test_exponent_one_and_no_stribeck_rise_are_the_spring_damper():
    points, strokes = random_rigs(10, seed=4)
    points[:, 3] = 0.0
    mu_s, k, b, _, mass, velocity = points.T
    one = np.ones_like(k)
    curved = np.stack([mu_s, 0 * one, 0.05 * one, k, one, b, mass, velocity], axis=1)
    value, _, seen = curved_pushes(curved, strokes, RungeKutta())
    closed_form = jax.jit(jax.vmap(partial(affine_push, integrator=ClosedForm())))
    expected, expected_seen = closed_form(points, strokes)
    np.testing.assert_array_equal(seen.kind, expected_seen.kind)
    np.testing.assert_allclose(value, expected, rtol=1e-7)


def test_second_derivatives_are_right():
    points, _ = random_rigs(8, seed=5)
    direction = jnp.array([1.0, -0.7, 0.5, 0.2, 0.6, 0.8])

    def second(integrator):
        def along(s, point):
            return affine_push(point * (1 + s * direction), None, integrator)[0]

        def slope(s, point):
            return jax.jvp(lambda s: along(s, point), (s,), (1.0,))[1]

        twice = jax.vmap(lambda point: jax.jvp(lambda s: slope(s, point), (0.0,), (1.0,)))
        return compiled(twice, integrator)(points)

    _, exact = second(ClosedForm())
    assert np.sum(exact != 0) >= 13  # a distance that does not exist has none
    # Each derivative costs digits: with RungeKutta's own tolerance these are right to 4e-6.
    for integrator in (Diffrax(), RungeKutta(tol=1e-12)):
        _, ours = second(integrator)
        np.testing.assert_allclose(ours, exact, rtol=1e-6)


def test_breakaway_is_the_laws_own():
    rig = Rig(10.0, Stribeck(0.2, 0.1, 0.05), Hertz(2e8, 1.5, 500.0))

    def breakaway(mu_s, velocity):
        moved = Rig(rig.mass, Stribeck(mu_s, 0.1, 0.05), rig.contact)
        return Diffrax().find_breakaway(moved, velocity)

    z_b = ((0.2 * 10 * G - 500 * 0.01) / 2e8) ** (1 / 1.5)
    value, slope = jax.jvp(lambda mu: breakaway(mu, 0.01), (0.2,), (1.0,))
    assert value == pytest.approx(z_b, rel=1e-12)
    assert slope == pytest.approx(z_b / 1.5 * 10 * G / (0.2 * 10 * G - 5), rel=1e-12)
    assert breakaway(0.2, 0.05) == 0.0


def test_a_part_that_breaks_away_during_a_ramp_goes_on():
    """Where friction is as large at rest as at first motion the part begins with no acceleration
    but that of rounding, which may point back."""
    rng = np.random.default_rng(0)
    n = 60
    points = 0.08 + 0.12 * rng.random(n), 10 ** rng.uniform(5.5, 6, n), 10 ** rng.uniform(2, 6, n)
    effects = {
        "stribeck": {"v_s_m_per_s": 1e-3},
        "contact_hardening": {"exponent": 1.005},
        "tilt": {"alpha_rad": 1e-5},
    }

    def follow(mu_s, k, acceleration):
        plain = spring_damper_rig(mass=18.9, mu_s=mu_s, k=k, b=1500.0, k_v=5.0, stroke=2e-3)
        ramp = {"pusher_ramp": {"acceleration_m_per_s2": acceleration}}
        rig = catalogue.extended(plain, {**effects, **ramp})
        end = RungeKutta(most=1000).build_loop(rig, 0.05, blind=True).run()
        return end.over, end.steps

    over, steps = jax.jit(jax.vmap(follow), compiler_options=OPTIONS)(*points)
    assert over.all() and steps.max() < 500


@pytest.mark.parametrize("closing", [True, False])
def test_states_within_a_leg(closing):
    rig = spring_damper_rig(mass=18.9, mu_s=0.14, k=8.5e5, b=2000.0, k_v=5.0)
    t = jnp.linspace(0.0, 5e-3, 7)
    start = (1e-5, 0.02, 0.03) if closing else (5e-5, 0.05, 0.03)

    def states(integrator):
        pushed = jax.vmap(lambda t: integrator.evaluate_pushed(rig, closing, *start, t))(t)
        return *pushed, *jax.vmap(lambda t: integrator.evaluate_free(rig, 0.02, t))(t)

    for ours, exact in zip(states(Diffrax()), states(ClosedForm()), strict=True):
        np.testing.assert_allclose(ours, exact, rtol=1e-8, atol=1e-14)


def test_refusals():
    curved = Rig(10.0, Stribeck(0.2, 0.1, 0.05), Hertz(2e8, 1.5, 500.0))
    with pytest.raises(InputError, match="Stribeck with Hertz is not"):
        ClosedForm().check(curved)
    Diffrax().check(curved)
    with pytest.raises(InputError, match="explicit Runge-Kutta method"):
        Diffrax(solver=diffrax.Kvaerno5()).check(curved)


def test_a_push_that_cannot_be_followed_says_so():
    """A law that gives no number, and too few steps: a reason, never a plausible number."""
    hertz = Hertz(k=jnp.asarray(jnp.nan), n=jnp.asarray(1.5), b=jnp.asarray(10.0))
    paper = spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1500.0, k_v=5.0)
    broken = Rig(paper.mass, paper.friction, hertz)
    for rig, integrator in ((broken, Diffrax()), (paper, Diffrax(max_steps=3))):
        seen = observe(rig, 0.05, integrator)
        assert jnp.isnan(seen.peak_force) and jnp.isnan(seen.sliding_distance)
        assert "could not be integrated" in Reason(int(seen.reason)).text


def test_bristles_of_any_stiffness_are_followed_in_as_many_steps():
    """They approach the plain rig with mu_s = mu_k as sigma_0^(-1/2), and a looser tolerance errs
    by no more than it says."""
    plain = spring_damper_rig(mass=18.9, mu_s=0.141, k=8e5, b=1500.0, k_v=5.0, stroke=2e-3)
    stiffness = jnp.array([1e6, 1e8, 1e9, 1e10])

    def push(sigma_0, v, tol):
        damping = 0.4 * jnp.sqrt(sigma_0 * 18.9)
        sizes = {"sigma_0_N_per_m": sigma_0, "sigma_1_N_s_per_m": damping}
        loop = RungeKutta(tol).build_loop(catalogue.extended(plain, {"presliding": sizes}), v, True)
        end = loop.run()
        seen = observe_steps(loop, end)
        return end.steps, jnp.stack([seen.peak_force, seen.sliding_distance])

    def follow(tol):
        each = jax.vmap(lambda s: push(s, 0.05, tol))
        return jax.jit(each, compiler_options=OPTIONS)(stiffness)

    steps, found = follow(1e-7)
    assert steps.max() < 1.2 * steps.min()
    np.testing.assert_allclose(found, follow(1e-11)[1], rtol=1e-6)
    alike = catalogue.extended(plain, {})
    alike = parameters.with_values(alike, {"mu_k_over_mu_s": 1.0, "mu_s": 0.75 * 0.141})
    seen = observe(alike, 0.05, ClosedForm())
    limit = jnp.stack([seen.peak_force, seen.sliding_distance])
    away = jnp.abs(found / limit - 1)
    np.testing.assert_allclose(away[2:] / away[1:-1], 10**-0.5, rtol=0.1)
