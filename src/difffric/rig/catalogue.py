"""The catalogue of effects: what may be added to equations (1), (2) and the sensors.

An effect is a law around a law of its component (a class of `friction`, `contact`, `pusher` or
`sensors`), with the keys that files write and the values at which it vanishes. To add one, write
its class and give it a line in `CATALOGUE`, in the order in which laws stand around each other:
inner ones first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from difffric.compute.number_tree import put_parts
from difffric.errors import InputError
from difffric.rig import contact, friction, pusher, sensors
from difffric.rig.rig import Rig

FRICTION, CONTACT, PUSHER, FORCE, PROBE = "friction", "contact", "pusher", "force_sensor", "probe"


@dataclass(frozen=True)
class Key:
    """One number of an effect as files write it."""

    name: str
    field: str
    null: float
    """what makes the effect vanish; of a shape parameter, any value does"""
    typical: float
    """a size that one may meet"""
    lower: float = 0.0
    upper: float = math.inf
    inverse: bool = False
    """whether the law holds the number's inverse, so that its null is a number"""
    fixed: bool = False
    """whether it stays at its null, the law's own default, unless another value is given"""

    def to_law(self, value: Any) -> Any:
        """The law's number for the file's, and the file's for the law's."""
        if not self.inverse:
            return value
        if isinstance(value, int | float) and value == 0:
            return float("inf")
        return 1.0 / value


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue."""

    id: str
    component: str
    law: Callable[..., Any]
    keys: tuple[Key, ...]
    text: str
    """what a person reads"""
    sign: str
    """what one sees of it"""
    confused: tuple[str, ...]
    """effects that look alike"""
    separated: str
    """what tells it from them"""
    given: tuple[str, ...] = ()
    """fields that each push's record says"""

    def nulls(self) -> dict[str, float]:
        """Key -> the value at which the effect vanishes."""
        return {key.name: key.null for key in self.keys}


def _free(name, field, typical, **more) -> Key:
    return Key(name, field, more.pop("null", 0.0), typical, **more)


_INF = float("inf")
_ANY = {"lower": -_INF}
_FAR = 10.0
"""No part gets so far [m]."""
_LIST = (
    Effect("tilt", FRICTION, friction.Tilt, (_free("alpha_rad", "alpha", 0.01, **_ANY),),
           "the rails are tilted",
           "a part of the friction that does not grow with mu_s",
           ("friction_ratio", "normal_force"), "pushes of two masses, and a wide range of mu_s"),
    Effect("normal_force", FRICTION, friction.ExtraLoad, (_free("extra_N", "extra", 10.0, **_ANY),),
           "a normal force beside the weight",
           "mu_s off by the same share at every speed",
           ("force_gain",), "pushes of two masses: at one mass it is one with mu_s"),
    Effect("friction_drift", FRICTION, friction.Drift, (_free("drift", "drift", 0.1, lower=-1.0),),
           "friction drifts over the order of the pushes",
           "mu_s that follows the order of the pushes",
           (), "speeds in random order; a repetition of the first push at the end",
           given=("share",)),
    Effect("friction_waviness", FRICTION, friction.Waviness,
           (_free("amplitude", "amplitude", 0.1, lower=-1.0, upper=1.0),
            _free("wavelength_m", "wavelength", 1e-3, null=1e-3),
            _free("phase_rad", "phase", 0.0, **_ANY)),
           "friction waves along the rails",
           "d that waves with its own length, a speed that waves with the position",
           ("friction_patch", "pusher_ripple"), "long slides of many lengths"),
    Effect("friction_patch", FRICTION, friction.Patch,
           (_free("amplitude", "amplitude", 0.2, lower=-1.0),
            _free("start_m", "start", 1e-3, null=_FAR)),
           "friction changes at a place",
           "a kink of the speed at one place, whatever the push's speed",
           ("friction_waviness",), "slides that end before the place and beyond it"),
    Effect("stribeck", FRICTION, friction.Stribeck,
           (_free("v_s_m_per_s", "v_s", 0.02), _free("delta", "delta", 2.0, null=2.0, fixed=True)),
           "sliding friction falls from mu_s with speed (Stribeck)",
           "slow pushes and the ends of slides braked more than fast ones",
           ("friction_ratio", "quadratic_drag"), "slow pushes beside fast ones"),
    Effect("quadratic_drag", FRICTION, friction.QuadraticDrag,
           (_free("c_N_s2_per_m2", "c", 200.0),), "drag grows as the square of the speed",
           "fast pushes that slide less far",
           ("stribeck",), "the fastest pushes that the rig makes"),
    Effect("static_dwell", FRICTION, friction.Dwell,
           (_free("amplitude", "amplitude", 0.03),
            _free("tau_s", "tau", 1.0, null=1.0, fixed=True)),
           "static friction grows with the rest before the push",
           "a higher force after a long rest, where the push sticks first",
           ("friction_ratio",), "slow pushes after rests of very different lengths",
           given=("rest",)),
    Effect("presliding", FRICTION, friction.Presliding,
           (_free("sigma_0_N_per_m", "compliance", 1e7, null=_INF, inverse=True),
            _free("sigma_1_N_s_per_m", "sigma_1", 100.0)),
           "bristles bend before they slip (LuGre)",
           "a part that moves before it slips and swings back at the end",
           ("contact_hardening",), "slow pushes of a soft contact"),
    Effect("rebound_damping", CONTACT, contact.ReboundDamping,
           (_free("b_N_s_per_m", "b", 500.0),), "a damper acts on rebound",
           "shorter d at the same F_p; a force that falls faster than it rose",
           ("contact_hardening",), "recordings of fast pushes"),
    Effect("contact_hardening", CONTACT, contact.Hardening,
           (_free("exponent", "exponent", 1.3, null=1.0, lower=1.0, upper=3.0),),
           "the contact stiffens with compression",
           "hard pushes stiffer than soft ones",
           ("rebound_damping", "force_saturation"), "a wide range of speeds"),
    Effect("initial_gap", CONTACT, contact.InitialGap, (_free("gap_m", "gap", 5e-5),),
           "the pusher starts a gap away",
           "a late, high peak, the whole push delayed by gap / v",
           ("pusher_ramp", "pusher_lag"), "slow pushes, where the delay is long"),
    Effect("pusher_speed", PUSHER, pusher.SpeedError,
           (_free("factor", "factor", 1.02, null=1.0),), "the pusher's true speed differs",
           "F_p and d of another speed",
           ("probe_scale", "force_gain"),
           "a recording of the pusher, or slow pushes whose part follows the tip"),
    Effect("pusher_ramp", PUSHER, pusher.Ramp,
           (_free("acceleration_m_per_s2", "slowness", 10.0, null=_INF, inverse=True),),
           "the pusher accelerates over a while",
           "no step of the force at t = 0",
           ("pusher_lag", "force_lowpass", "initial_gap"), "fast pushes: the ramp lasts v / a"),
    Effect("pusher_lag", PUSHER, pusher.Lag, (_free("tau_s", "tau", 1e-3),),
           "the pusher's speed lags its command",
           "no steps of the force, at the stop neither",
           ("pusher_ramp", "force_lowpass"), "pushes that are in contact when the pusher stops"),
    Effect("pusher_ripple", PUSHER, pusher.Ripple,
           (_free("amplitude", "amplitude", 0.05, lower=-1.0, upper=1.0),
            _free("period_m", "period", 1e-3, null=1e-3),
            _free("phase_rad", "phase", 0.0, **_ANY)),
           "the pusher's speed ripples along its travel",
           "a force that waves at the frequency v / p",
           ("friction_waviness",), "slow pushes with a long stroke"),
    Effect("pusher_duration", PUSHER, pusher.Duration,
           (_free("duration_s", "rate", 0.05, null=_INF, inverse=True),),
           "the pusher stops when its time is over",
           "parts caught again at low speed, where the tip goes on after the first release",
           ("pusher_speed",), "a recording of the pusher, or slow pushes of several speeds"),
    Effect("force_lowpass", FORCE, sensors.Lowpass, (_free("tau_s", "tau", 1e-4),),
           "the force channel's bandwidth is finite",
           "rounded steps, a late and lower peak",
           ("pusher_lag", "channel_skew", "sample_clipping"),
           "a position channel: it is not delayed"),
    Effect("force_highpass", FORCE, sensors.Highpass,
           (_free("tau_s", "leak", 0.5, null=_INF, inverse=True),), "the piezo's charge leaks",
           "a force that sags and undershoots after the release",
           ("force_offset",), "slow pushes with a long stroke"),
    Effect("force_gain", FORCE, sensors.Gain, (_free("factor", "factor", 1.02, null=1.0),),
           "the force sensor's sensitivity differs",
           "all forces off by one share",
           ("normal_force", "pusher_speed"), "distances beside the forces"),
    Effect("force_offset", FORCE, sensors.Offset, (_free("offset_N", "offset", 1.0, **_ANY),),
           "the force sensor's zero is off",
           "a force before the push",
           ("force_highpass", "tilt"), "a stretch of quiet before the push"),
    Effect("force_saturation", FORCE, sensors.Saturation,
           (_free("level_N", "level", 150.0, null=_INF),), "the force channel saturates",
           "forces that stop growing at one level",
           ("contact_hardening",), "fast pushes of a recording: the flat top"),
    Effect("sample_clipping", FORCE, sensors.SampledPeak,
           (_free("rate_Hz", "spacing", 2000.0, null=_INF, inverse=True),),
           "the peak falls between slow samples",
           "F_p too low, by another share at each speed",
           ("force_lowpass",), "the force sampled fast"),
    Effect("probe_scale", PROBE, sensors.ProbeScale, (_free("factor", "factor", 1.01, null=1.0),),
           "the probe's scale differs",
           "all distances off by one share",
           ("pusher_speed", "friction_ratio"), "slow pushes, whose part travels with the tip"),
    Effect("release_threshold", PROBE, sensors.ReleaseThreshold,
           (_free("threshold_N", "level", 5.0),), "loss of contact is taken at a force threshold",
           "d too long, most at low speed",
           ("channel_skew",), "the threshold lowered, or the recording itself"),
    Effect("release_latch", PROBE, sensors.ReleaseLatch,
           (_free("threshold_N", "sensitivity", 5.0, null=_INF, inverse=True),),
           "d is counted from the first fall of the force through a threshold",
           "d too long where the part is caught again",
           ("release_threshold",), "the recording itself"),
    Effect("channel_skew", PROBE, sensors.ChannelSkew, (_free("delay_s", "skew", 1e-4),),
           "the position lags the force",
           "d too long by a time at the speed of release",
           ("force_lowpass", "release_threshold"), "pushes of several speeds"),
)  # fmt: skip
CATALOGUE: dict[str, Effect] = {effect.id: effect for effect in _LIST}
"""id -> effect. `friction_ratio` is `mu_k_over_mu_s`, a parameter of equation (1) itself."""

CUTTING = ("pusher_duration",)
"""Effects that cut a push short."""
RATIO = "friction_ratio"
RATIO_SIGNS = (
    "stuck and sliding pushes that want different mu_s",
    ("tilt", "static_dwell", "stribeck"),
    "pushes that stick first beside ones that slip at once",
)
"""What one sees of another ratio, what looks alike, what tells it from them."""


def extended(rig: Rig, effects: Mapping[str, Mapping[str, Any]]) -> Rig:
    """The rig with these effects: id -> {key: value [SI]}; keys that are missing are null.

    Raises `InputError` for an unknown effect or key.
    """
    unknown = [x for x in effects if x not in CATALOGUE and x != RATIO]
    if unknown:
        known = ", ".join([*CATALOGUE, RATIO])
        raise InputError(f"no such effect: {', '.join(unknown)}; known: {known}")
    if RATIO in effects:
        ratio = effects[RATIO]["ratio"]
        rig = put_parts(rig, lambda r: [friction.innermost(r.friction).mu_k_over_mu_s], [ratio])
    for effect in _LIST:
        if effect.id in effects:
            rig = _around(rig, effect, effects[effect.id])
    return rig


def universal(rig: Rig) -> Rig:
    """The rig with every effect that vanishes at some value, at that value: one structure, and so
    one compiled program, for all of them. Bristles have no such value."""
    every = {e.id: {} for e in _LIST if e.id != "presliding"}
    return extended(rig, every)


def _around(rig: Rig, effect: Effect, values: Mapping[str, Any]) -> Rig:
    known = {key.name: key for key in effect.keys}
    wrong = [name for name in values if name not in known and name not in effect.given]
    if wrong:
        raise InputError(
            f"[effects.{effect.id}]: no such key: {', '.join(wrong)}; known: {', '.join(known)}"
        )
    fields = {}
    for key in effect.keys:
        value = values.get(key.name, key.null)
        if not (key.fixed and isinstance(value, int | float) and value == key.null):
            fields[key.field] = key.to_law(value)
    fields |= {name: values[name] for name in effect.given if name in values}
    law = effect.law(getattr(rig, effect.component), **fields)
    return replace(rig, **{effect.component: law})


KEYS: dict[str, tuple[Effect, Key]] = {
    f"{effect.id}.{key.name}": (effect, key)
    for effect in _LIST
    for key in effect.keys
    if not key.fixed
}
"""Parameter names of effects, `id.key`."""

GIVEN: dict[str, tuple[Effect, str]] = {
    f"{effect.id}.{name}": (effect, name) for effect in _LIST for name in effect.given
}
"""What each push's record says of an effect, `id.field`."""


def numbers_of(effect: str) -> tuple[str, ...]:
    """The parameters of an effect that a fit moves, as `parameters` names them."""
    if effect == RATIO:
        return ("mu_k_over_mu_s",)
    return tuple(f"{effect}.{key.name}" for key in CATALOGUE[effect].keys if not key.fixed)


def component_of(effect: str) -> str:
    """The component that an effect belongs to."""
    return FRICTION if effect == RATIO else CATALOGUE[effect].component


def parameter_names(rig: Rig) -> tuple[str, ...]:
    """The parameters of the effects that the rig has, in the catalogue's order."""
    return tuple(name for name, (effect, _) in KEYS.items() if _find_law(rig, effect) is not None)


def where(name: str):
    """(rig -> the law's number behind a name, how the law has a value)."""
    if name in GIVEN:
        effect, field = GIVEN[name]
        return lambda rig: getattr(_find_law(rig, effect), field), lambda value: value
    effect, key = KEYS[name]
    return lambda rig: getattr(_find_law(rig, effect), key.field), key.to_law


def with_numbers(rig: Rig, numbers: Mapping[str, Any]) -> Rig:
    """The rig with the laws' own numbers replaced, by parameter name: the inverse of an
    acceleration, for example, whose null is 0 and not infinite."""
    wheres = [where(name)[0] for name in numbers]
    return put_parts(rig, lambda r: [at(r) for at in wheres], list(numbers.values()))


def _find_law(rig: Rig, effect: Effect) -> Any:
    """The effect's law among those of its component; None where the rig has none."""
    at = getattr(rig, effect.component)
    while at is not None and not isinstance(at, effect.law):  # pyright: ignore[reportArgumentType]
        at = getattr(at, "law", None)
    return at
