"""The coordinates of an ensemble's fits: how a vector of numbers stands for an extended rig.

The plain parameters' coordinates are those of a calibration (`coordinates`). An effect's are 0 at
its null and of order 1 at a size that one may meet, and linear in the law's own number, which may
be the inverse of the one that files write: an effect that is absent is then a regular point.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import NDArray

from difffric.estimation.coordinates import limits, to_coordinate, to_value
from difffric.rig import catalogue, free_form, parameters
from difffric.rig.catalogue import CATALOGUE, KEYS
from difffric.rig.parameters import OF_LAWS, PARAMETERS
from difffric.rig.rig import Rig

PLAIN = OF_LAWS
"""The plain model's parameters. Their coordinates are a calibration's: logarithms, and k_v on a
linear scale."""
WAVES = {
    f"{e.id}.amplitude": f"{e.id}.phase_rad" for e in CATALOGUE.values() if "phase_rad" in e.nulls()
}
"""Amplitude -> phase of an effect that waves. Their coordinates are those of its sine and cosine,
in which a model is nearly linear; a phase is not, beside a small amplitude."""
FORMED = tuple(name for form in free_form.FORMS for name in free_form.names(form))
"""Coefficients of the free forms, which are coordinates themselves."""
_HUGE = 1e6
"""Stands for infinity, where a null is none: a level [N] that no force reaches."""


@dataclass(frozen=True)
class Coordinates:
    """How a vector c (K,) of numbers stands for an extended rig."""

    names: tuple[str, ...]
    """the parameter behind each number"""
    null: tuple[float, ...]
    """the law's own number at 0"""
    unit: tuple[float, ...]
    """the step of the law's own number that a step of 1 makes"""
    lowest: tuple[tuple[str, float], ...] = ()
    """names whose values [SI] the data let be no lower, and how low"""

    @classmethod
    def of(cls, rig: Rig) -> Coordinates:
        """The coordinates of a rig: the plain parameters, and all numbers of the effects that it
        has."""
        extra = catalogue.parameter_names(rig)
        keys = [KEYS[name][1] for name in extra]
        null = {n: _make_finite(key.to_law(key.null)) for n, key in zip(extra, keys, strict=True)}
        size = {n: abs(KEYS[n][1].to_law(KEYS[n][1].typical) - null[n]) or 1.0 for n in extra}
        for amplitude, phase in WAVES.items():
            if amplitude in size:
                size[phase] = size[amplitude]
        return cls(
            (*PLAIN, *extra),
            (0.0,) * len(PLAIN) + tuple(null.values()),
            (*(PARAMETERS[n].step or 1.0 for n in PLAIN), *size.values()),
        )

    def index(self, name: str) -> int:
        """The place of a name."""
        return self.names.index(name)

    def indices(self, names: Sequence[str]) -> list[int]:
        """The places of names."""
        return [self.names.index(name) for name in names]

    def point(self, values: Mapping[str, Any]) -> list[float]:
        """The coordinates of these values [SI, as files write them]. Of an effect that waves,
        amplitude and phase are given together."""
        out = {}
        for name, value in values.items():
            i = self.index(name)
            if name in PLAIN:
                out[name] = float(to_coordinate(name, value))
            else:
                number = _make_finite(KEYS[name][1].to_law(value))
                out[name] = float((number - self.null[i]) / self.unit[i])
        for amplitude, phase in WAVES.items():
            if amplitude in out:
                size, turn = out[amplitude], values[phase]
                out[amplitude], out[phase] = size * np.cos(turn), size * np.sin(turn)
        return list(out.values())

    def values(self, c: NDArray, names: Sequence[str]) -> list[float]:
        """The values [SI, as files write them] of some names at c."""
        return self._differentiate_values(c, names)[0].tolist()

    def errors(
        self, c: NDArray, names: Sequence[str], free: Sequence[int], covariance: NDArray
    ) -> list[float]:
        """Standard errors of the values of some names at c, from the covariance of the free
        coordinates, which may have further columns behind them; NaN where the data say nothing."""
        J = self._differentiate_values(c, names)[1][:, list(free)]
        covariance = covariance[: len(free), : len(free)]
        variance = np.einsum("ij,jk,ik->i", J, covariance, J)
        # Below zero by rounding, where the data say nothing: no number.
        return np.sqrt(np.where(variance >= 0, variance, np.nan)).tolist()

    def _differentiate_values(self, c: NDArray, names: Sequence[str]) -> tuple[NDArray, NDArray]:
        """Values (names,) [SI] and their derivatives (names, K) by all coordinates."""
        c = np.asarray(c, float)
        value, slope = np.zeros(len(names)), np.zeros((len(names), len(self.names)))
        phases = {phase: amplitude for amplitude, phase in WAVES.items()}
        for row, name in enumerate(names):
            i = self.index(name)
            number = self.null[i] + self.unit[i] * c[i]
            if name in PLAIN and PARAMETERS[name].step is not None:
                value[row], slope[row, i] = self.unit[i] * c[i], self.unit[i]
            elif name in PLAIN:
                value[row] = slope[row, i] = np.exp(c[i])
            elif name in WAVES or name in phases:
                amplitude = name if name in WAVES else phases[name]
                a, b = self.indices((amplitude, WAVES[amplitude]))
                size, unit = max(np.hypot(c[a], c[b]), 1e-12), self.unit[a]
                if name in WAVES:
                    value[row] = unit * size
                    slope[row, a], slope[row, b] = unit * c[a] / size, unit * c[b] / size
                else:
                    value[row] = np.arctan2(c[b], c[a])
                    slope[row, a], slope[row, b] = -c[b] / size**2, c[a] / size**2
            else:
                key = KEYS[name][1]
                value[row] = key.to_law(float(number))
                inverse = key.inverse and number
                slope[row, i] = -self.unit[i] / number**2 if inverse else self.unit[i]
        return value, slope

    def bounds(self, name: str) -> tuple[float, float]:
        """The coordinates between which a number makes sense."""
        if name in FORMED:
            return -np.inf, np.inf
        if name in PLAIN:
            return limits(name)
        name = next((a for a, phase in WAVES.items() if phase == name), name)
        key = KEYS[name][1]
        if key.inverse:
            return 0.0, np.inf
        i = self.index(name)
        lower = dict(self.lowest).get(name, key.lower)
        ends = [(x - self.null[i]) / self.unit[i] for x in (lower, key.upper)]
        return min(ends), max(ends)

    def rig(self, rig: Rig, c: Any, given: Mapping[str, Any], stroke: Any) -> Rig:
        """The rig of one push at coordinates c (coordinates,), with what the push's record says:
        numbers by name, and the pusher's stroke [m] or recorded motion; traceable."""
        at = parameters.with_push(rig, {**self._law_numbers(c), **given}, stroke)
        known = len(self.names) - len(FORMED)
        if self.names[known:] != FORMED:
            return at
        rows = c[known:].reshape(len(free_form.FORMS), free_form.SPLINES)
        return free_form.with_coefficients(at, dict(zip(free_form.FORMS, rows, strict=True)))

    def _law_numbers(self, c: Any) -> dict[str, Any]:
        """The laws' own numbers at coordinates c, by parameter name."""
        numbers: dict[str, Any] = {}
        for i, name in enumerate(self.names):
            if name in PLAIN:
                numbers[name] = to_value(name, c[i])
            elif name in KEYS:
                numbers[name] = self.null[i] + self.unit[i] * c[i]
        for amplitude, phase in WAVES.items():
            if amplitude in numbers:
                numbers[amplitude], numbers[phase] = _to_polar(numbers[amplitude], numbers[phase])
        return numbers

    def without(self, effect: str) -> Coordinates:
        """The coordinates without those of an effect's numbers."""
        return self._keep(name.partition(".")[0] != effect for name in self.names)

    def only(self, effects: Collection[str]) -> Coordinates:
        """The plain parameters' coordinates, and those of these effects' numbers."""
        return self._keep(name in PLAIN or name.partition(".")[0] in effects for name in self.names)

    def _keep(self, which: Iterable[bool]) -> Coordinates:
        """Some of the coordinates, by whether each is kept."""
        keep = list(which)

        def of(column: tuple) -> tuple:
            return tuple(compress(column, keep))

        return Coordinates(of(self.names), of(self.null), of(self.unit), self.lowest)

    def with_forms(self) -> Coordinates:
        """The coordinates with the coefficients of all free forms behind them."""
        none = (0.0,) * len(FORMED)
        null, unit = (*self.null, *none), (*self.unit, *none)
        return Coordinates((*self.names, *FORMED), null, unit, self.lowest)


def _to_polar(sine: Array, cosine: Array) -> tuple[Array, Array]:
    """Amplitude and phase of `sine sin + cosine cos`. Where both are zero neither has a derivative:
    zeros come back, whose derivatives are zeros."""
    nothing = (sine == 0) & (cosine == 0)
    safe = jnp.where(nothing, 1.0, sine)
    amplitude = jnp.where(nothing, 0.0, jnp.sqrt(safe**2 + cosine**2))
    return amplitude, jnp.where(nothing, 0.0, jnp.arctan2(cosine, safe))


def _make_finite(x: float) -> float:
    """The null, where it is infinite a level that nothing reaches."""
    return float(np.clip(x, -_HUGE, _HUGE))
