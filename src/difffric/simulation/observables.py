"""What is measured of a push: the peak push force F_p, the free-sliding distance d, and how
the push went. All of it can be differentiated and batched.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from difffric.compute import arrays as xp
from difffric.compute import pytrees
from difffric.compute.program_cache import cache_program
from difffric.rig.rig import Rig
from difffric.simulation.events import MAX_CONTACTS, MAX_CYCLES, Reason, Regime
from difffric.simulation.segments import Integrator, Push, State

if TYPE_CHECKING:
    from jaxtyping import Array, ArrayLike, Float, Int

    from difffric.simulation.stepping.loop import StepLoop
    from difffric.simulation.stepping.state import LoopState


class Observables(NamedTuple):
    """F_p and d of one push, in SI units, with its regime.

    NaN stands in `sliding_distance` where `reason` is not 0 (`events.explain` says why), and in
    both where the push could not be followed so far that its peak is decided.
    """

    peak_force: Array
    sliding_distance: Array
    reason: Array
    regime: Array
    stuck_first: Array
    contacts: Array
    kind: Array
    """a number that changes wherever a derivative may jump"""
    displacement: Array
    """from the part's start to where it rests for good [m], as the rig moves it and not as the
    probe reads it; NaN where it does so only for t to infinity, or could not be followed"""
    duration: Array
    """until tip and part stand for good [s]; NaN likewise"""


def _first_of(cases, otherwise) -> Any:
    """The value of the first condition that holds: plain selections, which vectorise
    (`numpy.select` would stack the conditions and search them)."""
    value = otherwise
    for condition, this in reversed(cases):
        value = xp.where(condition, this, value)
    return value


def observe(
    rig: Rig, velocity: Float[ArrayLike, ""], integrator: Integrator | None = None
) -> Observables:
    """F_p [N] and d [m] of one push at `velocity` [m/s]; the stroke is the rig's pusher's.

    Pure, compiled once for all rigs of a kind: vmap and differentiate it (forward mode), and
    jit what is built on it, as you like.
    """
    push = Push.of(rig, velocity, integrator)
    return _observe(pytrees.as_arrays(push))


@cache_program
def _observe(push: Push) -> Observables:
    from difffric.simulation.stepping.integrator import RungeKutta

    if isinstance(push.integrator, RungeKutta):
        loop = push.integrator.build_loop(push.rig, push.velocity)
        return observe_steps(loop, loop.run())
    return observe_segments(push, push.last_state())


def observe_steps(loop: StepLoop, m: LoopState) -> Observables:
    """F_p, d and the regime, read off the end of a push that was followed step by step."""
    rig, c = loop.motion.rig, m.course
    too_many = m.contacts > MAX_CONTACTS
    lost_track = m.lost_track | ~m.over | ~xp.isfinite(m.peak)
    for_ever = m.endless & ~c.stopped
    left = m.lost & ~c.touching
    sensor, probe = rig.force_sensor, rig.probe
    latched = False  # a latch counts to rest, wherever that is
    if m.sensed and probe.late:
        latched = m.sensed.crossed & xp.isfinite(probe.latch)
    reason = _first_of(
        [
            (too_many, Reason.TOO_MANY_CONTACTS),
            (lost_track, Reason.NOT_FOLLOWED),
            (for_ever, Reason.NEVER_RELEASED),
            (~(left | latched), Reason.RESTS_IN_CONTACT),
        ],
        Reason.OK,
    )
    regime = _first_of(
        [
            (~c.moved, Regime.NO_MOTION),
            (~left, Regime.PUSHED_TO_REST),
            (m.lost_moving, Regime.RELEASED_BY_REBOUND),
        ],
        Regime.RELEASED_AT_STOP,
    )
    peak = m.sensed.peak if m.sensed and (sensor.filtered or sensor.sampled) else m.peak
    x, x_lost = loop.motion.position(m.s), m.x_lost
    if loop.motion.bristles is not None:
        # Let go, the bristles stand upright, but for what holds the part on a slope.
        x = x - m.s.q - rig.slope / loop.motion.bristles.stiffness
    if m.sensed and probe.late:
        x_lost = xp.where(m.sensed.crossed, m.sensed.x_lost, x_lost)
    no_end = too_many | lost_track | for_ever | m.endless
    return Observables(
        peak_force=xp.where(too_many | lost_track, xp.nan, sensor.read(peak)),
        sliding_distance=xp.where(reason != Reason.OK, xp.nan, probe.read(x) - probe.read(x_lost)),
        reason=reason,
        regime=regime,
        stuck_first=m.stuck_first,
        contacts=m.contacts,
        kind=_kind(regime, m.stuck_first, latched, m.contacts, m.sticks, m.peak_contact),
        displacement=xp.where(no_end, xp.nan, x),
        duration=xp.where(no_end, xp.nan, m.s.t),
    )


_DECIDED = 3
"""Times that a part is held after which its peak has come: at the start, and after a slip."""


def _kind(regime, stuck_first, latched, *counts):
    kind = regime + 4 * stuck_first + 8 * latched
    for count in counts:
        kind = kind * 1024 + count % 1024  # so that neighbouring counts differ, however large
    return kind  # of three counts: 30 bits


def regime_of(kind: Int[NDArray, "*n"]) -> Int[NDArray, "*n"]:
    """The regime (a code of `events.Regime`) that a kind says."""
    return (np.asarray(kind) >> 30) % 4


def kind_of_peak(kind: Int[NDArray, "*n"]) -> Int[NDArray, "*n"]:
    """A number that changes wherever the derivative of F_p may jump, of that for F_p and d: once a
    part has been held again after a slip, how often it is held later is nothing to the peak."""
    kind = np.asarray(kind)
    sticks = (kind >> 10) % 1024
    return kind - ((sticks - np.minimum(sticks, _DECIDED)) << 10)


def observe_segments(push: Push, state: State) -> Observables:
    """F_p, d and the regime, read off the last state of a push in segments."""
    too_many = state.contacts > MAX_CONTACTS
    too_long = state.cycles >= MAX_CYCLES
    lost_track = ~xp.isfinite(state.peak)
    left = state.lost & ~state.in_contact
    # Behind a standing tip an overdamped rebound comes to rest too, if only asymptotically.
    for_ever = state.endless & (state.segment.v_p > 0)
    last, latch = state.segment, state.latch
    latched = False if latch is None else latch.closed  # it counts to rest, wherever that is
    reason = _first_of(
        [
            (lost_track, Reason.NOT_FOLLOWED),
            (too_many, Reason.TOO_MANY_CONTACTS),
            (too_long, Reason.TOO_MANY_CYCLES),
            (for_ever, Reason.NEVER_RELEASED),
            (~(left | latched), Reason.RESTS_IN_CONTACT),
            (state.endless, Reason.NEVER_RESTS),
        ],
        Reason.OK,
    )
    regime = _first_of(
        [
            (~state.moved, Regime.NO_MOTION),
            (~left, Regime.PUSHED_TO_REST),
            (state.lost_moving, Regime.RELEASED_BY_REBOUND),
        ],
        Regime.RELEASED_AT_STOP,
    )
    counts = state.contacts, state.sticks, state.peak_contact
    peak = push.rig.force_sensor.read(state.peak)
    slid = push.rig.probe.read(state.slid)
    no_end = lost_track | too_many | too_long | state.endless
    if latch is not None:
        since = push.rig.probe.read(last.y - last.z) - push.rig.probe.read(latch.x)
        slid = xp.where(latch.closed, since, slid)
    return Observables(
        # Of so many cycles in few contacts each is a smaller swing about steady sliding than the
        # one before: the peak is decided.
        peak_force=xp.where(lost_track | too_many, xp.nan, peak),
        sliding_distance=xp.where(reason != Reason.OK, xp.nan, slid),
        reason=reason,
        regime=regime,
        stuck_first=state.stuck_first,
        contacts=state.contacts,
        kind=_kind(regime, state.stuck_first, latched, *counts),
        displacement=xp.where(no_end, xp.nan, last.y - last.z),
        duration=xp.where(no_end, xp.nan, last.t),
    )
