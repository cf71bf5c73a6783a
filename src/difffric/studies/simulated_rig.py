"""A set-up's rig in front of a simulated card."""

from __future__ import annotations

import numpy as np

from difffric.acquisition.simulated_card import SimulatedCard
from difffric.errors import NumericalError
from difffric.rig import parameters
from difffric.rig.setup import Setup
from difffric.simulation.events import Reason
from difffric.simulation.trajectory import simulate
from difffric.units import to_mm_min

_NOISE_FORCE, _NOISE_POSITION = 0.5, 0.3e-6  # [N], [m], where the set-up says none


class SimulatedRig:
    """A set-up's rig under the push tip, each push with a mu_s of its own under `mu_s_scatter`
    (log-normal, by `seed`): the trace of a `SimulatedCard`, and in `truth` what was pushed.

    Raises `NumericalError` for a push that never comes to rest or cannot be followed.
    """

    def __init__(self, setup: Setup, seed: int = 0):
        self.rig, self.scatter = setup.rig, setup.mu_s_scatter or 0.0
        self.random = np.random.default_rng(seed)
        self.truth: list[dict] = []

    def __call__(self, velocity: float, stroke: float):
        """The push at any time, and when all of it is at rest [s]."""
        mean = float(parameters.values(self.rig)["mu_s"])
        mu_s = mean * float(np.exp(self.scatter * self.random.standard_normal()))
        push = simulate(self.rig, velocity, stroke=stroke, mu_s=mu_s)
        if push.reason not in (None, Reason.RESTS_IN_CONTACT.text):
            raise NumericalError(
                f"{to_mm_min(velocity):g} mm/min cannot be recorded: {push.reason}"
            )
        d = None if push.reason else float(push.sliding_distance)
        self.truth.append(
            {
                "mu_s": mu_s,
                "peak_force_N": float(push.peak_force),
                "sliding_distance_m": d,
                "reason": push.reason,
                "regime": push.regime,
            }
        )

        def evaluate(t):
            force, position, _ = push.evaluate(t)
            return np.asarray(force), np.asarray(position)

        return evaluate, max(float(push.stop_time), stroke / velocity)


def make_simulated_card(
    setup: Setup, rate: float | None, seed: int
) -> tuple[SimulatedCard, list[dict]]:
    """A card before the set-up's rig, and the list that its pushes' truth goes to."""
    rig, pushed = setup.rig, SimulatedRig(setup, seed)
    sensor, probe = rig.force_sensor, rig.probe
    card = SimulatedCard(
        pushed,
        rate=float(sensor.rate) if rate is None else rate,
        sensitivity=float(sensor.sensitivity),
        range=float(sensor.range),
        noise_force=_NOISE_FORCE if sensor.noise is None else float(sensor.noise),
        resolution=float(probe.resolution),
        noise_position=_NOISE_POSITION if probe.noise is None else float(probe.noise),
        seed=seed,
    )
    return card, pushed.truth
