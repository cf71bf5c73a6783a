"""Other ways to centre a ring, to compare difffric's with: each measures it after every push.

All plan on the same exact model. They differ in what they know of friction and in which speeds they
take.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from difffric.centering.belief import Belief
from difffric.centering.loop import Centering, centre
from difffric.centering.machine import Machine, PushReadings
from difffric.centering.planning import Known, Plan
from difffric.identification.surrogates import fit_distance, fit_force, weigh_by_ranges
from difffric.rig import parameters
from difffric.simulation.families import family

SURROGATES, NOMINAL, SLOWEST, SLOWEST_BOOKED = "surrogates", "nominal", "slowest", "slowest_booked"
RIVALS = {
    SURROGATES: "(a) mu_s of the last push from equations (4), (6), (7), fitted to the set-up",
    NOMINAL: "(b) the set-up's mu_s, always",
    SLOWEST: "(c) always the slowest push; mu_s as difffric finds it",
    SLOWEST_BOOKED: "(c) with the probe's displacements, as difffric keeps them",
}


class Rivals:
    """The other ways for what is `known` of one set-up; its surrogates are fitted once."""

    def __init__(self, known: Known):
        self.known = known
        # Without a stroke, as the paper's own: the pusher stops at the first loss of contact.
        self.family = family(parameters.with_stroke(known.rig, None))
        self.force, self.distance = fit_force(self.family), fit_distance(self.family)
        nominal = float(parameters.values(known.rig)["mu_s"])
        self.nominal = Belief.normal(nominal, 0.0, known.mu_s.scatter)

    def centre(self, machine: Machine, rival: str) -> Centering:
        """Centre a ring by one of `RIVALS`."""
        if rival == SURROGATES:
            known = replace(self.known, mu_s=self.nominal)
            return centre(machine, known, measure_each=True, identify=self._by_surrogates)
        if rival == NOMINAL:
            known = replace(self.known, mu_s=self.nominal)
            return centre(machine, known, measure_each=True, identify=lambda *_: None)
        known = replace(self.known, speeds=self.known.speeds[:1])
        return centre(machine, known, measure_each=rival == SLOWEST)

    def _by_surrogates(self, known: Known, plan: Plan, readings: PushReadings) -> Belief | None:
        """Return what way (a) knows after a push; None where its readings give no mu_s."""
        mu_s = combine_surrogates(self, plan.next.velocity, readings)
        if not np.isfinite(mu_s):
            return None
        return Belief.normal(float(np.clip(mu_s, 0.02, 1.0)), 0.0, known.mu_s.scatter)


def combine_surrogates(rivals: Rivals, velocity: float, readings: PushReadings) -> float:
    """Return a push's mu_s by equations (4), (6) and (7), by (4) alone where (6) has no answer.

    `velocity` is in m/s.
    """
    force, distance = rivals.force, rivals.distance
    by_force = float(force.mu_s(velocity, readings.peak_force))
    by_distance = float(distance.mu_s(velocity, readings.sliding_distance))
    if not np.isfinite(by_distance):
        return by_force
    slopes = (
        float(force.slope(velocity, by_force)),
        float(distance.slope(velocity, by_distance)),
    )
    return float(weigh_by_ranges(by_force, by_distance, *slopes, rivals.family.range_ratio)[0])
