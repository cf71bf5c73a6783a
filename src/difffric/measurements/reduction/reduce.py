"""F_p and d from recorded pushes, without a model, unbiased by noise, with standard errors.

F_p is the vertex of a local polynomial at the force's maximum, or its value at a jump. d runs from
the edge at which the force of the last contact reaches its level without contact, to rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.compute.pytrees import map_tree
from difffric.errors import InputError
from difffric.measurements.noise import LONGEST, Noise, estimate_quiet_noise, pool_noise, read_quiet
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.measurements.reduction.contacts import find_contacts
from difffric.measurements.reduction.early_rise import find_early_rise
from difffric.measurements.reduction.landmarks import coarsen, find_peak, find_rest, find_slide
from difffric.measurements.reduction.release import find_release

WITHOUT_CONTACT = "without contact: the force never rises above its noise"
NEVER_RESTS = "never comes to rest within the recording"
RESTS_IN_CONTACT = "rests in contact"
_HELD = 1 << 18  # samples of a channel that are kept in memory while a push is reduced, 2 MB
_SHORT = 1e-5  # a slide [m] so short that a small force at rest says more
_ABOUT = 2.5  # intervals to either side of a time that its position is averaged over


@dataclass(frozen=True)
class Reduced:
    """What one recording says without a model, SI units; NaN: not to be had, see `reason`."""

    peak_force: float = np.nan
    """F_p, as the sensor reads it [N]"""
    peak_force_se: float = np.nan
    peak_time: float = np.nan
    """[s]"""
    sliding_distance: float = np.nan
    """d [m]; noise can make a tiny one negative"""
    sliding_distance_se: float = np.nan
    release_time: float = np.nan
    """the last loss of contact [s]"""
    release_time_se: float = np.nan
    release_velocity: float = np.nan
    """the part's speed there [m/s]"""
    release_velocity_se: float = np.nan
    deceleration: float = np.nan
    """mean over the free slide [m/s^2]"""
    deceleration_se: float = np.nan
    rest_position: float = np.nan
    """[m], from the position's own zero"""
    rest_position_se: float = np.nan
    rest_time: float = np.nan
    """from here on no motion is seen [s]"""
    latched_distance: float = np.nan
    """d [m] as a latch at the first loss of contact counts it, where contact is lost again later"""
    onsets: tuple[float, ...] = ()
    """times at which a contact begins, the first included [s]"""
    partings: tuple[float, ...] = ()
    """about when each contact but the last ends [s]"""
    jumps: tuple[float, ...] = ()
    """times at which the force jumps inside a contact: the pusher's stop [s]"""
    force_level: float = np.nan
    """the sensor's reading without contact [N]"""
    noise_force: Noise | None = None
    noise_position: Noise | None = None
    problem: str = ""
    """why the recording is no push at all: without contact, or before t = 0, or never at rest"""
    reason: str = ""
    """why something is missing, or less certain; empty where nothing is"""


def reduce_push(
    recording: Recording, noise_force: Noise | None = None, noise_position: Noise | None = None
) -> Reduced:
    """One recording reduced. Noise that is not given is estimated from the recording itself.

    Raises `InputError` for a force still in volts, for samples that are not finite, and for
    channels of fewer than 16 samples.
    """
    try:
        return _reduce(recording, noise_force, noise_position)
    except InputError as error:
        raise InputError(f"{recording.name}: {error}".lstrip(": ")) from None


def _reduce(
    recording: Recording, noise_force: Noise | None, noise_position: Noise | None
) -> Reduced:
    recording = replace(recording, force=_hold(recording.force), position=_hold(recording.position))
    force, position = recording.force, recording.position
    if force is not None and force.unit != "N":
        raise InputError(f"force is in {force.unit}, expected N")
    out, reasons = Reduced(), []
    if position is None:
        reasons.append("no position channel: no sliding distance")
    else:
        out = _with_rest(out, recording, noise_position)
    if force is None:
        reasons.append("no force channel: neither peak nor loss of contact is seen")
    else:
        out = _with_force(out, recording, noise_force, reasons)
    if out.problem:
        reasons.append(out.problem)
    return replace(out, reason="; ".join(reasons))


def _hold(channel: Channel | None) -> Channel | None:
    """The channel in memory, where it is short: its parts are asked for some ten times."""
    if channel is None or channel.n > _HELD:
        return channel
    return Channel.of(channel.samples, channel.dt, channel.start, channel.unit)


def _with_rest(out: Reduced, recording: Recording, noise: Noise | None) -> Reduced:
    position = recording.position
    assert position is not None
    used = noise or estimate_quiet_noise(position)
    rest = find_rest(position, used, recording.velocity)
    if rest is not None and noise is None:  # the rest, too, says what the noise is
        used = estimate_quiet_noise(position, rest.time)
        rest = find_rest(position, used, recording.velocity)
    out = replace(out, noise_position=used)
    if rest is None:
        return replace(out, problem=NEVER_RESTS)
    return replace(out, rest_position=rest.value, rest_position_se=rest.se, rest_time=rest.time)


def _with_force(
    out: Reduced, recording: Recording, noise: Noise | None, reasons: list[str]
) -> Reduced:
    force, position = recording.force, recording.position
    assert force is not None
    noise = noise or estimate_quiet_noise(force)
    quiet = read_quiet(force)
    if len(quiet) < 8:
        reasons.append("no quiet time: the force's zero is taken as read")
    level = float(np.mean(quiet)) if len(quiet) >= 8 else 0.0
    coarse = coarsen(force, noise)
    contacts = find_contacts(force, coarse, level)
    out = replace(out, noise_force=noise, force_level=level)
    early = find_early_rise(force, above_rest=not contacts)
    if not contacts:
        return replace(out, problem=str(early or WITHOUT_CONTACT))
    if early:
        reasons.append(str(early))
    peak = find_peak(force, coarse, contacts, noise)
    last = contacts[-1]
    out = replace(
        out,
        peak_force=peak.value,
        peak_force_se=peak.se,
        peak_time=peak.time,
        onsets=tuple(c.onset for c in contacts),
        partings=tuple(c.end for c in contacts[:-1]),
        jumps=tuple(t for c in contacts for t in c.jumps),
    )
    if np.isnan(peak.value):
        reasons.append("too few samples in contact: no peak force")
    if np.isinf(last.end):
        if not out.problem:
            reasons.append(RESTS_IN_CONTACT)
        return out
    stop = recording.stroke / recording.velocity
    release = find_release(force, coarse, last, noise, stop)
    out = replace(out, release_time=release.time, release_time_se=release.time_se)
    if position is None or np.isnan(out.rest_time):
        return out
    noise_position = out.noise_position
    assert noise_position is not None
    begin = last.segments[-1][0]
    slide = find_slide(position, release.time, begin, out.rest_time, noise_position)
    if slide is None:
        reasons.append("too few samples between release and rest: no sliding distance")
        return out
    if slide.position > out.rest_position - _SHORT and _presses(force, noise, quiet, out.rest_time):
        reasons.append(f"{RESTS_IN_CONTACT}, or the force's zero has drifted")
        return out
    if len(contacts) > 1:
        out = replace(out, latched_distance=out.rest_position - _read(position, contacts[0].end))
    # x(t) is curved: an error of the release time, of either sign, takes it off the true x.
    delay = release.time_se
    bent = slide.acceleration / 2 * delay**2
    variance = (
        out.rest_position_se**2 + slide.position_se**2 + (slide.velocity * delay) ** 2 + 2 * bent**2
    )
    return replace(
        out,
        sliding_distance=out.rest_position - slide.position + bent,
        sliding_distance_se=float(np.sqrt(variance)),
        release_velocity=slide.velocity,
        release_velocity_se=float(
            np.hypot(slide.velocity_se, slide.acceleration * release.time_se)
        ),
        deceleration=slide.deceleration,
        deceleration_se=slide.deceleration_se,
    )


def _read(position: Channel, t: float) -> float:
    """The position [m] about a time [s]: the mean of a few samples; NaN where there are none."""
    _, x = position.between(t - _ABOUT * position.dt, t + _ABOUT * position.dt)
    return float(np.mean(x)) if len(x) else np.nan


def _presses(force: Channel, noise: Noise, quiet: NDArray, rest_time: float) -> bool:
    """Whether the force at rest is above that before the push, however little."""
    rest = force.between(rest_time, rest_time + LONGEST * force.dt)[1]
    if len(quiet) < 8 or len(rest) < 8:
        return False
    spread = np.hypot(noise.average(len(quiet)).level, noise.average(len(rest)).level)
    return bool(np.mean(rest) - np.mean(quiet) > 4 * spread)


@dataclass(frozen=True)
class Reduction:
    """Reduced recordings: what a fit takes, and all else that was found, an entry a push."""

    recordings: Recordings
    """those that were kept"""
    pushes: Pushes
    details: tuple[Reduced, ...]


def refuse_or_skip(
    recordings: Recordings, details: Sequence[Reduced], skip_bad: bool = False
) -> tuple[list[int], tuple[str, ...]]:
    """(indices of the usable pushes, a line for each of the others).

    Raises `InputError`, which names every group without contact or without rest, unless
    `skip_bad`; and where nothing is left.
    """
    file = f"{recordings.source}: " if recordings.source else ""
    bad = {i: r.problem for i, r in enumerate(details) if r.problem}
    lines = tuple(f"{file}{recordings[i].name or f'push {i}'} {why}" for i, why in bad.items())
    keep = [i for i in range(len(recordings)) if i not in bad]
    if bad and not (skip_bad and keep):
        named = "; ".join(line.removeprefix(file) for line in lines)
        raise InputError(f"{file}{named}: expected pushes that touch the part and end at rest")
    return keep, lines


def reduce_recordings(recordings: Recordings, *, skip_bad: bool = False) -> Reduction:
    """All recordings reduced, with the noise pooled over them where their rates agree.

    Raises `InputError` for pushes without contact or without rest, unless `skip_bad`, and for
    what `reduce_push` refuses.
    """
    noises = [_pool_where_alike(recordings, which) for which in ("force", "position")]
    details = [reduce_push(r, *noises) for r in recordings]
    keep, lines = refuse_or_skip(recordings, details, skip_bad)
    kept = replace(recordings.select(keep), skipped=(*recordings.skipped, *lines))
    details = tuple(details[i] for i in keep)

    def column(name, of=details):
        return np.array([getattr(x, name) for x in of], float)

    tiny = ~(
        (column("sliding_distance") > 0) & (column("release_velocity") > 0)
    )  # noise may make it so; a measurement cannot be
    details = tuple(
        replace(r, reason="; ".join(filter(None, [r.reason, "sliding distance within its noise"])))
        if r.sliding_distance <= 0
        else r
        for r in details
    )
    pushes = Pushes(
        velocity=column("velocity", kept),
        peak_force=column("peak_force"),
        peak_force_se=column("peak_force_se"),
        sliding_distance=np.where(tiny, np.nan, column("sliding_distance")),
        sliding_distance_se=np.where(tiny, np.nan, column("sliding_distance_se")),
        release_velocity=np.where(tiny, np.nan, column("release_velocity")),
        release_velocity_se=np.where(tiny, np.nan, column("release_velocity_se")),
        condition=tuple(r.condition for r in kept),
        source=recordings.source,
        motion=_stack_motions(kept),
        skipped=kept.skipped,
        notes=kept.notes,
        **{name: column(name, kept) for name in _COPIED},
    )
    return Reduction(kept, pushes, details)


def _stack_motions(recordings: Recordings) -> Any:
    """The motions that drive the tips, stacked; None where they go at their commanded speeds."""
    motions = [r.motion for r in recordings]
    if any(motion is None for motion in motions):
        return None
    laws = [motion.law for motion in motions]
    return map_tree(lambda *leaves: np.stack(leaves), laws[0], *laws[1:])


_COPIED = ("mass", "stroke", "mu_s_gauge", "order", "rest_before")


def _pool_where_alike(recordings: Recordings, which: str) -> Noise | None:
    """The pooled noise, None where each push must speak for itself: other rates, no quiet time."""
    channels = [c for r in recordings if (c := getattr(r, which)) is not None]
    if not channels or np.ptp([c.dt for c in channels]) > 1e-6 * channels[0].dt:
        return None
    if not any(len(read_quiet(c)) >= 16 for c in channels):
        return None
    return pool_noise(recordings, which)
