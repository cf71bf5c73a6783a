"""Friction laws: what the rails do to the part. Equation (1) stands here."""

from __future__ import annotations

import abc
from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Float


class AbstractFriction(eqx.Module):
    """A friction law.

    To add one, subclass, give it its parameters as fields (SI units) and the two methods
    below; each must be smooth. Set `affine = True` only where `sliding` is affine in `u`:
    the closed form then serves it, otherwise it is integrated.
    """

    affine: ClassVar[bool] = False

    @abc.abstractmethod
    def sliding(self, u: Float[Array, ""], F_N: Float[Array, ""]) -> Float[Array, ""]:
        """Friction force [N] on a part that slides at speed u > 0 [m/s] under F_N [N]."""

    @abc.abstractmethod
    def breakaway(self, F_N: Float[Array, ""]) -> Float[Array, ""]:
        """F_S, the force [N] at which a part at rest starts to slide."""


class ViscousCoulomb(AbstractFriction):
    """Equation (1): `mu_k F_N + k_v v` while sliding; at rest equal to the applied force
    up to `F_S = mu_s F_N`.

    `mu_k = mu_k_over_mu_s * mu_s` follows mu_s; the paper takes 0.75 throughout.
    """

    mu_s: Float[Array, ""] | float
    mu_k_over_mu_s: Float[Array, ""] | float = 0.75
    k_v: Float[Array, ""] | float = 0.0
    affine: ClassVar[bool] = True

    @property
    def mu_k(self):
        """Coefficient of sliding friction."""
        return self.mu_k_over_mu_s * self.mu_s

    def sliding(self, u, F_N):
        return self.mu_k * F_N + self.k_v * u

    def breakaway(self, F_N):
        return self.mu_s * F_N
