"""One hidden-effect case: a rig, what is hidden in it, its pushes, its noise. SI units.

All that is drawn stands in the case itself but for the samples' noise, which follows from the seed,
so that a case whose effect is scaled has the same pushes still.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from tests.hidden.outsiders import TABLE as OUTSIDERS
from tests.hidden.sizes import AMPLITUDES, Amplitude
from tests.reference.effect_parameters import NULLS

MM_MIN = 1e-3 / 60
SPEEDS_MM_MIN = (500, 500, 800, 800, 1000, 1000, 1500, 2000, 2500, 3000, 3500, 4000, 4500, 5000)
RECORDINGS, TABLE = "recordings", "table"
TABLE_ONLY = ("sample_clipping", "release_threshold", "release_latch")
"""effects of how a table is read off: recordings do not have them"""
RECORDINGS_ONLY = ("probe_backlash",)
"""what a difference of two late positions does not have"""
COMPONENTS = {
    **dict.fromkeys(tuple(NULLS)[:10], "friction"),
    **dict.fromkeys(("contact_hardening", "rebound_damping", "initial_gap"), "contact"),
    **dict.fromkeys(("pusher_ramp", "pusher_lag", "pusher_ripple", "pusher_speed"), "pusher"),
    "pusher_duration": "pusher",
    **dict.fromkeys(("force_gain", "force_offset", "force_lowpass"), "force_sensor"),
    **dict.fromkeys(("force_highpass", "force_saturation", "sample_clipping"), "force_sensor"),
    **dict.fromkeys(("probe_scale", "release_threshold", "release_latch"), "probe"),
    "channel_skew": "probe",
}
assert set(COMPONENTS) == set(NULLS)

Effects = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Push:
    """One push as commanded, and its own static friction."""

    velocity: float
    mu_s: float
    order: int
    rest_before: float
    """[s]"""
    condition: str = "A"
    mass: float = math.nan
    """[kg]; NaN: the rig's"""


@dataclass(frozen=True)
class Noise:
    """Standard deviation of one sample (of a table: of one reading), AR(1) coefficient in time."""

    force: float = 0.5
    position: float = 0.3e-6
    force_phi: float = 0.0
    position_phi: float = 0.0


@dataclass(frozen=True)
class Case:
    """A case and its truth; `effects` is what has to be named, {} where nothing has to be."""

    seed: int
    kind: str
    rig: Mapping[str, float]
    """mass_kg (a push's own goes before), mu_k_over_mu_s, k_v_N_s_per_m, k_N_per_m, b_N_s_per_m"""
    mu_s: Mapping[str, float]
    """condition -> its median mu_s"""
    scatter: float
    """standard deviation of log mu_s from push to push"""
    pushes: Sequence[Push]
    effects: Effects = field(default_factory=dict)
    """id of the catalogue -> {key: value}, keys as in [effects.ID]"""
    outsider: Effects = field(default_factory=dict)
    """name of `outsiders` -> {key: value}"""
    nuisances: Effects = field(default_factory=dict)
    """effects of the catalogue that are there and too small to matter"""
    s_curve: bool = False
    """whether pusher_ramp is an S, not a line"""
    stroke: float | None = 2e-3
    noise: Noise = Noise()
    resolution: float = 20e-9
    """of the probe [m]"""
    rate: float = 10e3
    """[Hz]"""
    before: float = 20e-3
    """quiet time before the push [s]"""
    after: float = 30e-3
    """and after the part came to rest"""
    phase: float = 0.5
    """when the first sample from t = 0 is taken, in intervals"""
    jitter: float = 0.0
    """standard deviation of the recorder's t = 0 [s]"""

    @property
    def present(self) -> dict[str, Mapping[str, float]]:
        """All effects of the catalogue in it, nuisances too."""
        return {**self.nuisances, **self.effects}

    @property
    def components(self) -> tuple[str, ...]:
        """The components in which something is hidden."""
        found = [COMPONENTS[effect] for effect in self.effects]
        return tuple(found + [OUTSIDERS[name].component for name in self.outsider])

    def mass_of(self, push: Push) -> float:
        """[kg]"""
        return self.rig["mass_kg"] if math.isnan(push.mass) else push.mass

    @property
    def masses(self) -> tuple[float, ...]:
        """All masses that occur [kg]."""
        return tuple(sorted({self.mass_of(push) for push in self.pushes}))

    def plain(self) -> Case:
        """The same rig and pushes with nothing hidden in them."""
        return replace(self, effects={}, outsider={}, nuisances={}, s_curve=False)

    def with_effect(self, name: str, values: Mapping[str, float]) -> Case:
        """With these values of an effect or outsider."""
        if name in NULLS:
            return replace(self, effects={**self.effects, name: dict(values)})
        return replace(self, outsider={**self.outsider, name: dict(values)})

    def only(self, name: str) -> Case:
        """With this effect or outsider alone."""
        effects = {key: x for key, x in self.effects.items() if key == name}
        outsider = {key: x for key, x in self.outsider.items() if key == name}
        return replace(self, effects=effects, outsider=outsider, nuisances={})

    def values(self, name: str) -> Mapping[str, float]:
        """Of a hidden effect or outsider."""
        return self.effects[name] if name in self.effects else self.outsider[name]

    def scaled(self, name: str, factor: float) -> Case:
        """With so many times the size of one hidden effect."""
        return self.with_effect(name, amplitude(name).scaled(self.values(name), factor))

    def factors(self, name: str) -> tuple[float, float]:
        """Those that make a hidden effect the smallest and the largest."""
        return amplitude(name).factors(self.values(name))

    @property
    def hidden(self) -> tuple[str, ...]:
        """What is hidden in it, outsiders last."""
        return (*self.effects, *self.outsider)

    def truth(self) -> dict:
        """As JSON has it."""
        told = asdict(self)
        return {key: _jsonable(value) for key, value in told.items()}


def amplitude(name: str) -> Amplitude:
    """What of an effect or outsider is scaled."""
    return AMPLITUDES[name] if name in AMPLITUDES else OUTSIDERS[name].amplitude


def _jsonable(value):
    if isinstance(value, Mapping):
        return {key: _jsonable(x) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(x) for x in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value.item() if isinstance(value, np.generic) else value


def draw_pushes(
    rng: np.random.Generator,
    mu_s: Mapping[str, float],
    scatter: float,
    speeds: Sequence[float],
    masses: Sequence[float] = (math.nan,),
) -> tuple[Push, ...]:
    """A push at each of the speeds [m/s], in random order, its conditions and masses in turn."""
    n, conditions = len(speeds), list(mu_s)
    which = rng.permutation(np.arange(n) % len(conditions))
    heavy = rng.permutation(np.arange(n) % len(masses))
    shuffled = rng.permutation(np.asarray(speeds, float))
    rests = np.exp(rng.uniform(0, math.log(1000), n))
    return tuple(
        Push(
            velocity=float(shuffled[i]),
            mu_s=float(mu_s[conditions[which[i]]] * math.exp(scatter * rng.standard_normal())),
            order=i,
            rest_before=float(f"{rests[i]:.3g}"),
            condition=conditions[which[i]],
            mass=float(masses[heavy[i]]),
        )
        for i in range(n)
    )


def practice_speeds(n: int) -> np.ndarray:
    """n speeds over 500-5000 mm/min [m/s]: those of the practice sets, the slow ones twice."""
    if n == len(SPEEDS_MM_MIN):
        return MM_MIN * np.array(SPEEDS_MM_MIN)
    every = np.unique(SPEEDS_MM_MIN)
    if n < len(every):
        every = every[np.round(np.linspace(0, len(every) - 1, n)).astype(int)]
    return MM_MIN * np.resize(every, n)
