"""How often a watched machine raises a false alarm, and how soon it tells of a change.

    python -m studies.monitoring [--page PAGE] [--pushes N] [--runs N]

The tables are printed and set between two marks of the page. Three levels:

- the statistic alone, on standard normal numbers: 1e6 pushes (`--pushes`);
- the whole chain but for the simulator: `F_p` and `d` of 1e6 pushes by the library's own model,
  noise and scatter added, read (`monitoring.readings`), judged and charted as the monitor does,
  many machines at once;
- `Monitor` itself, fed one push after another, for the delays and for what changed.

All that is random has a fixed seed.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np
from scipy.special import ndtri, stdtr

import difffric as df
from difffric.monitoring import shiryaev_roberts
from difffric.monitoring.change_cause import CANDIDATES, conclude
from difffric.monitoring.monitor import PRIOR, Monitor
from difffric.monitoring.readings import Reader
from difffric.rig import catalogue, parameters
from difffric.rig.setup import Setup
from difffric.units import from_mm, from_mm_min
from studies import runs

PAGE = runs.ROOT / "docs" / "monitor.md"
COMMAND = "python -m studies.monitoring"
SCATTER, NOISE_N, NOISE_M = 0.015, 0.5, 0.3e-6
SPEEDS = (2000.0, 3000.0, 5000.0)
"""[mm/min]"""
BEFORE = 100
"""Pushes before a change."""
LATEST = 150
"""Pushes after a change that are waited for an alarm."""
RIG = df.spring_damper_rig(mass=18.9, mu_s=0.141, k=8.0e5, b=1500.0, k_v=5.0, stroke=from_mm(1.2))
STEPS = (
    ("mu_s", 1.05), ("mu_s", 1.10), ("mu_s", 1.20), ("mu_s", 0.95),
    ("k_N_per_m", 1.05), ("k_N_per_m", 1.10), ("k_N_per_m", 1.20),
    ("b_N_s_per_m", 1.10), ("b_N_s_per_m", 1.20),
    ("force_gain.factor", 1.02), ("force_gain.factor", 1.05), ("probe_scale.factor", 1.05),
)  # fmt: skip
DRIFTS = (0.0005, 0.001, 0.002)
"""of mu_s, per push"""


def measured(rng, velocity, mu_s, **changed) -> tuple[np.ndarray, np.ndarray]:
    """(n,) F_p and d of pushes with scatter and noise; `changed` are factors of parameters."""
    rig = catalogue.extended(RIG, {"force_gain": {"factor": 1.0}, "probe_scale": {"factor": 1.0}})
    own = mu_s * np.exp(SCATTER * rng.standard_normal(len(velocity)))
    now = parameters.values(rig)
    new = {name: float(now[name]) * np.asarray(f) for name, f in changed.items()}
    seen = df.observe_batch(
        parameters.with_values(rig, {**new, "mu_s": own}), velocity, derivatives=()
    )
    noise = rng.standard_normal((2, len(velocity)))
    return seen.peak_force + NOISE_N * noise[0], seen.sliding_distance + NOISE_M * noise[1]


def of_statistic(arl: float, pushes: int, seed: int = 1) -> tuple[float, int]:
    """(pushes per alarm, alarms): machines side by side, of the same many pushes each, begun anew
    after each alarm. What is left over at the end counts as pushes without alarm."""
    machines = 100
    rng, log_R = (
        np.random.default_rng(seed),
        np.repeat(shiryaev_roberts.start()[None], 100, axis=0),
    )
    alarms, threshold = 0, shiryaev_roberts.log_threshold(arl)
    for _ in range(pushes // machines):
        log_R = shiryaev_roberts.update(log_R, rng.standard_normal((machines, 2)))
        over = shiryaev_roberts.total(log_R) >= threshold
        alarms += int(over.sum())
        log_R[over] = -np.inf
    return pushes / alarms, alarms


class _Judge:
    """`monitoring.baseline` for many machines at once: the same recursions, arrays (machines,)."""

    def __init__(self, machines: int):
        self.weight, self.value = np.zeros((2, machines, len(SPEEDS)))
        self.squares = np.full((machines, len(SPEEDS)), PRIOR)
        self.count = np.full((machines, len(SPEEDS)), PRIOR)

    def __call__(self, y, h, k) -> np.ndarray:
        i = np.arange(len(y))
        w, m = self.weight[i, k], self.value[i, k]
        first = w == 0
        with np.errstate(divide="ignore", invalid="ignore"):
            residual = (y - m) / np.sqrt(h + 1 / w)
        t = residual / np.sqrt(self.squares[i, k] / self.count[i, k])
        z = np.where(first, np.nan, -np.sign(t) * ndtri(stdtr(self.count[i, k], -np.abs(t))))
        near = first | (np.abs(z) <= shiryaev_roberts.FARTHEST)
        self.weight[i, k] += np.where(near, 1 / h, 0)
        self.value[i, k] += np.where(near, (y - m) / h / self.weight[i, k], 0)
        self.squares[i, k] += np.where(first, 0, residual**2)
        self.count[i, k] += ~first
        return z


def of_chain(arl: float, pushes: int, seed: int = 2) -> tuple[float, int, int]:
    """(pushes per alarm, alarms, pushes that were not identified), from F_p and d on. After an
    alarm the means of that machine begin anew, as the monitor's do."""
    machines, rng = 100, np.random.default_rng(seed)
    n = pushes // machines
    k = rng.integers(len(SPEEDS), size=(n, machines))
    velocity = from_mm_min(np.array(SPEEDS))[k]
    F_p, d = measured(rng, velocity.ravel(), 0.141)
    said = df.Pushes(
        velocity=velocity.ravel(), peak_force=F_p, sliding_distance=d,
        peak_force_se=np.full(F_p.size, NOISE_N), sliding_distance_se=np.full(F_p.size, NOISE_M),
    )  # fmt: skip
    read = Reader(RIG).read(said)
    lost = sum(x is not None for x in read.reason)
    y, c = read.log_mu_s.reshape(n, -1), read.contrast.reshape(n, -1)
    h = SCATTER**2 + read.error.reshape(n, -1) ** 2
    friction, contrast = _Judge(machines), _Judge(machines)
    log_R, alarms = np.repeat(shiryaev_roberts.start()[None], machines, axis=0), 0
    for i in range(n):
        z = np.stack([friction(y[i], h[i], k[i]), contrast(c[i], np.ones(machines), k[i])], axis=1)
        log_R = shiryaev_roberts.update(log_R, z)
        over = shiryaev_roberts.total(log_R) >= shiryaev_roberts.log_threshold(arl)
        alarms += int(over.sum())
        log_R[over] = -np.inf
        for judge in (friction, contrast):
            judge.weight[over], judge.value[over] = 0.0, 0.0
    return pushes / alarms, alarms, lost


def watched(seed: int, changes, drift: float = 0.0) -> tuple[float, str | None, bool]:
    """(pushes from the change to its alarm, infinite where none came; the parameter that is named
    20 pushes later; whether there was a false alarm before) of one machine."""
    rng = np.random.default_rng(seed)
    n = BEFORE + LATEST
    after = np.arange(n) >= BEFORE
    velocity = from_mm_min(np.array(SPEEDS))[rng.integers(len(SPEEDS), size=n)]
    mu_s = 0.141 * np.exp(drift * np.maximum(np.arange(n) - BEFORE + 1, 0))
    factors = {name: np.where(after, f, 1.0) for name, f in changes}
    mu_s = mu_s * factors.pop("mu_s", 1.0)
    F_p, d = measured(rng, velocity, mu_s, **factors)
    monitor, ends = Monitor(Setup(RIG, SCATTER)), n
    for i in range(n):
        seen = monitor.update(
            float(velocity[i]), float(F_p[i]), float(d[i]), peak_force_se=NOISE_N,
            sliding_distance_se=NOISE_M, order=float(i),
        )  # fmt: skip
        if seen.alarm and i < BEFORE:
            return np.nan, None, True
        if seen.alarm and ends == n:
            ends = i + 21
        if i + 1 >= ends:
            break
    if not monitor.alarms:
        return np.inf, None, False
    first = monitor.alarms[0]
    return first.push - BEFORE, conclude(first.causes(monitor.reader))[0], False


def delays(count: int) -> list[tuple[str, ...]]:
    """A row for each change: median and 90th percentile of the delay, how often it was named."""
    cases = [(CANDIDATES[name], 100 * (f - 1), [(name, f)], 0.0) for name, f in STEPS]
    rows = []
    for text, size, change, drift in [
        *cases, *(("friction, drift", 100 * x, [], x) for x in DRIFTS)
    ]:  # fmt: skip
        found = [watched(1000 + i, change, drift) for i in range(count)]
        found = [x for x in found if not x[2]]
        wait = np.array([x[0] for x in found])
        own = change[0][0] if change else "mu_s"
        right = sum(x[1] == own for x in found)
        wrong = sum(x[1] is not None and x[1] != own for x in found)
        rows.append(
            (
                text, f"{size:+.3g} %" + (" a push" if drift else ""),
                f"{np.median(wait):.3g}", f"{np.percentile(wait, 90):.3g}",
                f"{right} of {len(found)}", f"{wrong}",
            )
        )  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def lines(pushes: int, count: int) -> list[str]:
    out = ["| level | stated | measured | alarms | pushes |", "| --- | --- | --- | --- | --- |"]
    for arl in (50.0, 200.0, 1000.0):
        mean, alarms = of_statistic(arl, pushes)
        out.append(f"| statistic | {arl:g} | {mean:.4g} | {alarms} | {pushes} |")
        print(out[-1], flush=True)
    mean, alarms, lost = of_chain(1000.0, pushes)
    out.append(f"| from `F_p` and `d` on | 1000 | {mean:.4g} | {alarms} | {pushes} |")
    print(out[-1], lost, "not identified", flush=True)
    out += ["", f"Of the pushes from `F_p` and `d` on, {lost} could not be identified.", ""]
    out += [
        "| change | size | median delay | 90 % within | named | named wrongly |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    return out + [f"| {' | '.join(row)} |" for row in delays(count)]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--pushes", type=int, default=1_000_000)
    parser.add_argument("--runs", type=int, default=100)
    given = parser.parse_args(arguments)
    jax.config.update("jax_enable_x64", True)
    found = lines(given.pushes, given.runs)
    runs.write_into(given.page, "\n".join(found), "monitor-study")


if __name__ == "__main__":
    main()
