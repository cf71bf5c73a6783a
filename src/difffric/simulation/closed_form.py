"""The closed-form integrator: exact legs of a push wherever every law is affine."""

from __future__ import annotations

from math import factorial
from typing import TYPE_CHECKING

from difffric.compute import arrays as xp
from difffric.compute.arrays import polynomial, slope
from difffric.compute.elementary_functions import angle, quotient
from difffric.compute.event_root import find_falling_root
from difffric.compute.number_tree import NumberTree
from difffric.compute.pytrees import select
from difffric.errors import InputError
from difffric.rig.number import Number, Truth
from difffric.rig.rig import Rig
from difffric.simulation.events import Event
from difffric.simulation.force_latch import ForceFall
from difffric.simulation.leg import Leg, first_event
from difffric.simulation.oscillator import Oscillator, ViscousSlide

if TYPE_CHECKING:
    from jaxtyping import Array, Float

_ROUNDING = 1e-11
"""A force below zero by less than this share of friction's is none."""
_SINE, _COSINE, _DECAY = (
    [sign**n / factorial(per * n + more) for n in range(5)]
    for sign, per, more in ((-1.0, 2, 1), (-1.0, 2, 0), (1.0, 1, 0))
)
"""Series of sin(x)/x and cos(x) in x^2, and of exp(x), for small x."""


def _oscillator(acceleration, v_p):
    """The compression's oscillator and its equilibrium, read off equation (2).

    z'' = -x'' with x' = v_p - z', so that z'' = -a(z, z'); a is affine.
    """

    def a(z, w):
        return acceleration(z, w, v_p - w)

    a_z, a_w = slope(lambda z: a(z, 0.0), v_p), slope(lambda w: a(0.0, w), v_p)
    return Oscillator(0.5 * a_w, a_z), -a(0.0, 0.0) * quotient(1.0, a_z)


def _slide(rig, u):
    """The slide without contact, for a part of the speed u."""
    return ViscousSlide(-rig.free(0.0), -slope(rig.free, u))


def _gap(t, args):
    """Distance of the part ahead of a tip that moves at v_p, and its rate."""
    drag, rate, u, ahead, v_p = args
    s, u_t = ViscousSlide(drag, rate).flow(u, t)
    return ahead + s - v_p * t, u_t - v_p


def _grip(t, args):
    """How far a free part that is still within the spring's reach, z > 0, is from the edge at which
    a damped rebound would hold it again, in lengths: z + lever w < 0 there; and its rate. Both with
    the sign turned, so that it falls."""
    drag, rate, u, z, v_p, lever = args
    s, u_t = ViscousSlide(drag, rate).flow(u, t)
    w = v_p - u_t
    return -(z + v_p * t - s + lever * w), -(w + lever * (drag + rate * u_t))


def _compression(t, args):
    alpha, omega0_sq, xi, w, z_e = args
    p, dp = Oscillator(alpha, omega0_sq).flow(xi, w, t)
    return z_e + p, dp


def _undershoot(t, args):
    """How far z' still is below the tip's speed v_p: zero where the part halts."""
    alpha, omega0_sq, w, dw, v_p = args
    p, dp = Oscillator(alpha, omega0_sq).flow(w, dw, t)
    return v_p - p, -dp


class ClosedForm(NumberTree):
    """Equation (2) with affine laws, solved on paper: exact to rounding, fast, and
    differentiable to any order in forward mode.
    """

    def check(self, rig: Rig) -> None:
        """Raise `InputError` where a law of the rig has no closed form."""
        if not rig.affine:
            raise InputError(
                "the closed form needs affine laws; "
                f"{type(rig.friction).__name__} with {type(rig.contact).__name__} is not: "
                "leave the integrator out, or give integrator=Diffrax()"
            )

    def find_breakaway(self, rig: Rig, v_p: Number) -> Float[Array, ""]:
        """Compression [m] at which a part at rest starts to slide; 0: at once."""
        at_touch = rig.contact.approach(0.0, v_p)
        stiffness = slope(lambda z: rig.contact.approach(z, v_p), v_p)
        F_S = rig.friction.breakaway(rig.F_N)
        sticks = F_S > at_touch
        return xp.where(sticks, (F_S - at_touch) * quotient(1.0, stiffness), 0.0)

    def follow_closing(
        self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number, may_halt: bool
    ) -> Leg:
        """The tip closes in on the part, until w = 0, the part halts or the pusher stops."""
        osc, z_e = _oscillator(rig.approaching, v_p)
        xi, w = z - z_e, v_p - u
        dw = -2 * osc.alpha * w - osc.omega0_sq * xi
        turn = _unless_steady(osc, xi, w, z_e, osc.turning_time(xi, w, 1.0))
        halt = xp.inf
        if may_halt:  # not where one cycle is all: from rest the part only speeds up
            # With mu_k = mu_s the breakaway has no acceleration: its rounding is no fall.
            falling = dw > 1e-12 * osc.omega0_sq * z_e
            top = osc.turning_time(w, xp.where(falling, dw, 1.0), 1.0)
            # Masked by what holds in this mode, so that other lanes of a batch search for nothing.
            halts = (
                falling
                & (w < v_p)
                & (v_p > 0)
                & (osc.extremum(w, dw, xp.where(falling, top, 0.0)) > v_p)
            )
            top = xp.where(halts, top, 0.0)
            args = (osc.alpha, osc.omega0_sq, w, dw, v_p)
            halt = xp.where(
                halts, find_falling_root(_undershoot, args, 0.0, top, 0.5 * top), xp.inf
            )
            # Caught as it comes to rest, its last speed lost in rounding.
            halt = xp.where(falling & (w >= v_p) & (v_p > 0), 0.0, halt)
        dt, event = first_event((left, Event.STOP), (turn, Event.TURN), (halt, Event.HALT))
        at_turn = osc.extremum(xi, w, _finite(dt))
        if may_halt:
            p, dp = osc.flow(xi, w, _finite(dt))
            p, dp = (
                xp.where(event == Event.TURN, at_turn, p),
                xp.where(event == Event.TURN, 0.0, dp),
            )
        else:
            p, dp = at_turn, xp.zeros_like(at_turn)  # without a stroke nothing else ends it
        z_1 = z_e + p
        u_1 = xp.where(event == Event.TURN, v_p, xp.where(event == Event.HALT, 0.0, v_p - dp))
        peak = self._find_peak(rig, osc, z_e, xi, w, dw, turn, dt, (p, dp))
        return Leg(dt, event, z_1, u_1, 0.0, peak)

    def _find_peak(self, rig, osc, z_e, xi, w, dw, turn, dt, end):
        """Largest contact force of a closing: the force obeys the same oscillator."""
        k = slope(lambda z: rig.contact.approach(z, 0.0), dt)
        b = slope(lambda w: rig.contact.approach(0.0, w), dt)
        N_e = rig.contact.approach(z_e, 0.0)
        N, dN = k * xi + b * w, k * w + b * dw
        rises = dN > 0
        top = osc.turning_time(xp.where(rises, N, -1.0), xp.where(rises, dN, 0.0), 1.0)
        inside = rises & (top <= dt) & xp.isfinite(top)
        summit = osc.extremum(N, dN, xp.where(inside, top, 0.0))
        # Overdamped, the force may dip first, and creep up to its equilibrium without an end.
        at_end = xp.where(xp.isinf(dt), 0.0, k * end[0] + b * end[1])
        return N_e + xp.where(inside, summit, xp.where(at_end > N, at_end, N))

    def follow_rebounding(self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number) -> Leg:
        """The part recedes from the tip, until release, w = 0 or the pusher's stop."""
        if rig.contact.parts_early:
            return self._follow_damped_rebound(rig, z, u, v_p, left)
        osc, z_e = _oscillator(rig.rebounding, v_p)
        xi, w = z - z_e, v_p - u
        turn = _unless_steady(osc, xi, w, z_e, osc.turning_time(xi, w, -1.0))
        finite = xp.isfinite(turn)
        t_turn = xp.where(finite, turn, 0.0)
        depth = osc.extremum(xi, w, t_turn)
        leaves = finite & (depth >= z_e) & (z >= 0) & (w <= 0)
        guess = t_turn - _release_phase(osc, z_e, xp.where(leaves, depth, z_e))
        args = (osc.alpha, osc.omega0_sq, xi, w, z_e)
        upto = xp.where(leaves, t_turn, 0.0)
        parting = find_falling_root(_compression, args, 0.0, upto, guess, 1)
        release = xp.where(leaves, parting, xp.inf)
        ends = (release, Event.RELEASE), (xp.where(leaves, xp.inf, turn), Event.TURN)
        if rig.pusher.stroke is None:  # no stop: what the root was found with serves again
            dt, event = first_event(*ends)
            p, dp = osc.flow(xi, w, parting)
        else:
            dt, event = first_event((left, Event.STOP), *ends)
            p, dp = osc.flow(xi, w, _finite(dt))
        p = xp.where(event == Event.TURN, -depth, p)
        z_1 = xp.where(event == Event.RELEASE, 0.0, z_e + p)
        u_1 = xp.where(event == Event.TURN, v_p, v_p - dp)
        return Leg(dt, event, z_1, u_1, 0.0, 0.0)

    def _follow_damped_rebound(self, rig, z, u, v_p, left):
        """The same where a damper acts on rebound. Contact is lost where the force falls to zero:
        over the stiffness it is z + lever w, beyond its equilibrium an oscillation of the same
        kind, which is lowest before the part turns."""
        osc, z_e = _oscillator(rig.rebounding, v_p)
        xi, w = z - z_e, v_p - u
        lever = _find_lever(rig, v_p)
        f, df = xi + lever * w, w - lever * (2 * osc.alpha * w + osc.omega0_sq * xi)
        turn = _unless_steady(osc, xi, w, z_e, osc.turning_time(xi, w, -1.0))
        lowest = xp.where(df > 0, xp.inf, osc.turning_time(f, df, -1.0))
        # Where the tip has just stopped the damper may pull at once. (By more than the rounding of
        # a part that was caught on this very edge.)
        gone = f < -z_e * (1 + _ROUNDING)
        finite = xp.isfinite(turn) & xp.isfinite(lowest)
        until = xp.where(finite, lowest, 0.0)
        depth = osc.extremum(f, df, until)
        leaves = finite & (depth >= z_e) & ~gone & (w <= 0)
        guess = until - _release_phase(osc, z_e, xp.where(leaves, depth, z_e))
        args = (osc.alpha, osc.omega0_sq, f, df, z_e)
        parting = find_falling_root(_compression, args, 0.0, xp.where(leaves, until, 0.0), guess, 1)
        release = xp.where(gone, 0.0, xp.where(leaves, parting, xp.inf))
        turn = xp.where(leaves | gone, xp.inf, turn)
        dt, event = first_event((left, Event.STOP), (release, Event.RELEASE), (turn, Event.TURN))
        p, dp = osc.flow(xi, w, _finite(dt))
        p = xp.where(event == Event.TURN, -osc.extremum(xi, w, _finite(dt)), p)
        z_1 = xp.where((event == Event.RELEASE) & ~gone, -lever * dp, z_e + p)
        u_1 = xp.where(event == Event.TURN, v_p, v_p - dp)
        return Leg(dt, event, z_1, u_1, 0.0, 0.0)

    def find_force_fall(
        self, rig: Rig, closing: bool, z: Number, u: Number, v_p: Number, dt: Number
    ) -> ForceFall:
        """How the force goes along a pushed leg of dt [s]: it obeys the same oscillator, and falls
        from its top or from the start to its lowest point or to the end."""
        law, motion = (
            (rig.contact.approach, rig.approaching)
            if closing
            else (rig.contact.rebound, rig.rebounding)
        )
        osc, z_e = _oscillator(motion, v_p)
        xi, w = z - z_e, v_p - u
        k, b = slope(lambda z: law(z, 0.0), v_p), slope(lambda w: law(0.0, w), v_p)
        above = law(z_e, 0.0) - rig.probe.latch
        n, dn = k * xi + b * w, k * w - b * (2 * osc.alpha * w + osc.omega0_sq * xi)
        rises, end = dn > 0, _finite(dt)
        top = xp.where(rises, xp.minimum(_finite(osc.turning_time(n, dn, 1.0)), end), 0.0)
        low = xp.where(rises, xp.inf, osc.turning_time(n, dn, -1.0))
        until = xp.minimum(low, end)
        args = (osc.alpha, osc.omega0_sq, n, dn, above)
        highest, lowest = _compression(top, args)[0], _compression(until, args)[0]
        falls = (highest >= 0) & (lowest < 0)
        top, until = xp.where(falls, top, 0.0), xp.where(falls, until, 0.0)
        time = find_falling_root(_compression, args, top, until, 0.5 * (top + until))
        last = _compression(end, args)[0] + rig.probe.latch
        first = law(z, w)
        return ForceFall(first, last, xp.where(falls, time, xp.inf))

    def follow_free(
        self, rig: Rig, z: Number, u: Number, v_p: Number, left: Number, may_catch: bool
    ) -> Leg:
        """The part slides without contact, until rest, the pusher's stop or the next contact."""
        slide = _slide(rig, u)
        t_rest, s_rest = slide.rest(u)
        if not may_catch:
            return Leg(t_rest, xp.full_like(left, Event.HALT, int), z - s_rest, 0.0, s_rest, 0.0)
        horizon = xp.minimum(t_rest, left)
        args = (*slide, u, -z, v_p)
        caught = (v_p > 0) & (z <= 0) & (_gap(horizon, args)[0] <= 0)
        early = xp.inf
        if rig.contact.parts_early:
            early = self._find_early_catch(rig, slide, z, u, v_p, left)
            # Else it leaves the spring's reach, if the tip does not stop before.
            leaves = (v_p > 0) & (z > 0) & xp.isinf(early) & (_slow_down(slide, u, v_p) < horizon)
            caught = caught | (leaves & (_gap(horizon, args)[0] <= 0))
        # The gap is concave: it grows until u = v_p, and falls ever faster from there.
        since = xp.where(caught, _slow_down(slide, u, v_p), 0.0)
        upto = xp.where(caught, horizon, 0.0)
        catch = xp.where(caught, find_falling_root(_gap, args, since, upto, upto), xp.inf)
        catch = xp.minimum(catch, early)
        dt, event = first_event((left, Event.STOP), (catch, Event.CATCH), (t_rest, Event.HALT))
        s, u_1 = slide.flow(u, dt)
        s = xp.where(event == Event.HALT, s_rest, s)
        z_1 = xp.where(event == Event.CATCH, 0.0, z + v_p * dt - s)
        if rig.contact.parts_early:
            again = (event == Event.CATCH) & xp.isfinite(early)
            z_1 = xp.where(again, -_find_lever(rig, v_p) * (v_p - u_1), z_1)
        return Leg(dt, event, z_1, xp.where(event == Event.HALT, 0.0, u_1), s, 0.0)

    def _find_early_catch(self, rig, slide, z, u, v_p, left):
        """When a part that was let go within the spring's reach, z > 0, is held again: it slows
        down, the damper would pull less, and the force is none of pulling any more. Infinite where
        it gets out of reach."""
        lever = _find_lever(rig, v_p)
        # z + lever w is lowest where w = -lever dw/dt, and z where part and tip are equally fast.
        slower = 1 - lever * slide.rate
        bends = slower > 0  # else it only falls from the release on
        deepest = (v_p + lever * slide.drag) * quotient(1.0, xp.where(bends, slower, 1.0))
        since = xp.where(bends, _slow_down(slide, u, deepest), 0.0)
        even = _slow_down(slide, u, v_p)
        upto = xp.minimum(even, left)
        args = (*slide, u, z, v_p, lever)
        held = (z > 0) & (u > v_p) & (since < upto) & (_grip(upto, args)[0] < 0)
        since, upto = xp.where(held, since, 0.0), xp.where(held, upto, 0.0)
        return xp.where(held, find_falling_root(_grip, args, since, upto, upto), xp.inf)

    def evaluate_pushed(
        self, rig: Rig, closing: Truth, z: Number, u: Number, v_p: Number, t: Number
    ) -> tuple[Array, Array]:
        """(z, u) at the time t into a pushed leg; the oscillator is chosen, not its solution."""
        legs = _oscillator(rig.approaching, v_p), _oscillator(rig.rebounding, v_p)
        osc, z_e = select(closing, *legs)
        p, dp = osc.flow(z - z_e, v_p - u, t)
        return z_e + p, v_p - dp

    def evaluate_free(self, rig: Rig, u: Number, t: Number) -> tuple[Array, Array]:
        """(distance, u) at the time t into a free leg."""
        return _slide(rig, u).flow(u, t)


def _release_phase(osc, z_e, depth):
    """How long before its turn at -depth the compression passes zero: nearly, and exactly
    without damping.

    Seen back from the turn, exp(c a) (cos a - c sin a) = z_e / depth at the phase a = omega t,
    with c = alpha / omega. Two of Halley's steps from the a of c = 0, whose cosine and sine are
    known; what the first adds to a is of the order of c, so that series turn them on.
    """
    rate = osc.rate()
    c = quotient(osc.alpha, rate)
    cosine = quotient(z_e, depth)
    sine = xp.sqrt(xp.maximum(1.0 - cosine**2, 1e-30))
    phase = angle(sine, cosine)
    fading = xp.exp(-c * phase) * cosine

    def step(sine, cosine, fading):
        excess = cosine - c * sine - fading
        slope, bend = (1.0 + c**2) * sine, (1.0 + c**2) * (cosine + c * sine)
        return 2 * excess * slope / (2 * slope**2 + excess * bend)

    more = step(sine, cosine, fading)
    s, k = more * polynomial(_SINE, more**2), polynomial(_COSINE, more**2)
    turned = sine * k + cosine * s, cosine * k - sine * s
    phase = phase + more + step(*turned, fading * polynomial(_DECAY, -c * more))
    return quotient(phase, rate)


def _find_lever(rig, like):
    """By how much a rebound's damper moves the edge of contact: damping over stiffness [s]."""
    stiffness = slope(lambda z: rig.contact.rebound(z, 0.0), like)
    return slope(lambda w: rig.contact.rebound(0.0, w), like) * quotient(1.0, stiffness)


def _slow_down(slide, u, to):
    """The time [s] in which a free part slows down from the speed u to another [m/s]; 0 where it is
    no faster."""
    level = ViscousSlide(slide.drag + slide.rate * to, slide.rate)
    return xp.where(u > to, level.rest(xp.where(u > to, u - to, 0.0))[0], 0.0)


def _finite(t):
    return xp.where(xp.isfinite(t), t, 0.0)


def _unless_steady(osc, xi, w, z_e, turn):
    """An oscillation below rounding is steady sliding: it has no next turn."""
    energy = osc.omega0_sq * xi**2 + w**2
    return xp.where(energy > osc.omega0_sq * (1e-13 * z_e) ** 2, turn, xp.inf)
