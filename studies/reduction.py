"""How far off F_p and d are, in standard errors, on recordings of random rigs.

    python -m studies.reduction [rigs] [rate_Hz] [correlation] [told]

The recordings are those of `reference.data`: 14 pushes a rig, 0.5 N and 0.3 µm of noise. `told`:
the stroke that a recording says, over the true one; nan: it says none.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.measurements.reduction.reduce import Reduced, reduce_recordings
from tests.reference import data


class Row(NamedTuple):
    """One push: its truth and what was found."""

    rig: int
    push: data.Push
    found: Reduced
    z_force: float
    z_distance: float

    @property
    def regime(self) -> str:
        course = self.push.course
        return f"{course.regime}, {'one contact' if course.contacts == 1 else 'several contacts'}"


def recordings_of(
    rig: data.Rig, rng, rate=1e4, rho=0.0, told=1.0
) -> tuple[list[data.Push], Recordings]:
    """14 pushes, and what was recorded of them."""
    pushes, recorded = data.make_pushes(rig, rng), []
    for push in pushes:
        x = data.record(push, rng, rate=rate, noise=data.Noise(rho=rho))
        recorded.append(
            Recording(
                push.velocity,
                Channel.of(x.force, x.dt, x.start, "N"),
                Channel.of(x.position, x.dt, x.start, "m"),
                stroke=np.nan if push.stroke is None else told * push.stroke,
                name=f"push {len(recorded)}",
            )
        )
    return pushes, Recordings(tuple(recorded))


def survey(
    rigs, rate: float = 1e4, rho: float = 0.0, told: float = 1.0, spent: list | None = None
) -> Iterator[Row]:
    """The pushes of each rig number in `rigs`; seconds taken for each are appended to `spent`."""
    for number in rigs:
        rng = np.random.default_rng(number)
        pushes, recordings = recordings_of(data.random_rig(rng), rng, rate, rho, told)
        begin = time.process_time()
        details = reduce_recordings(recordings, skip_bad=True).details
        if spent is not None:
            spent.append(time.process_time() - begin)
        if len(details) < len(pushes):
            print(f"rig {number}: {len(pushes) - len(details)} refused")
            continue
        for push, found in zip(pushes, details, strict=True):
            z_force = (found.peak_force - push.peak_force) / found.peak_force_se
            error = found.sliding_distance - push.sliding_distance
            yield Row(number, push, found, z_force, error / found.sliding_distance_se)


def summary(name: str, z: np.ndarray) -> str:
    """One line on z (n,), without those that are NaN."""
    z = z[np.isfinite(z)]
    if not len(z):
        return f"{name:44} none"
    return (
        f"{name:44} {len(z):4}  mean {z.mean():+.2f}  sd {z.std():8.2f}  "
        f"1.4826 MAD {1.4826 * np.median(abs(z - np.median(z))):.2f}  "
        f"|z| > 1.96: {np.mean(abs(z) > 1.96):6.2%}  > 4: {np.sum(abs(z) > 4)}  "
        f"max {abs(z).max():.1f}"
    )


def main(rigs: int = 60, rate: float = 1e4, rho: float = 0.0, told: float = 1.0) -> None:
    spent: list[float] = []
    rows = list(survey(range(rigs), rate, rho, told, spent))
    z_force, z_distance = (np.array([r[i] for r in rows]) for i in (3, 4))
    regimes = np.array([r.regime for r in rows])
    print(summary("F_p", z_force))
    print(summary("d", z_distance))
    for regime in sorted(set(regimes)):
        print(summary(f"  F_p, {regime}", z_force[regimes == regime]))
        print(summary(f"  d, {regime}", z_distance[regimes == regime]))
    exists = np.isfinite([r.push.sliding_distance for r in rows])
    given = np.isfinite([r.found.sliding_distance for r in rows])
    print(f"d: exists {exists.sum()}, of which given {(exists & given).sum()};")
    print(f"   does not exist {(~exists).sum()}, of which given {(~exists & given).sum()}")
    for row in rows:
        p, f, d = row.push, row.found, row.push.sliding_distance
        lost = np.isfinite(d) != np.isfinite(f.sliding_distance)
        if lost or abs(row.z_force) > 4 or abs(row.z_distance) > 4:
            print(
                f"rig {row.rig} {f'{6e4 * p.velocity:.0f}':>4} mm/min {p.course.regime} "
                f"{p.course.contacts}/{len(f.onsets)} "
                f"F_p {p.peak_force:.2f} z {row.z_force:+.1f} se {f.peak_force_se:.3f}  "
                f"d {1e6 * d:.2f} z {row.z_distance:+.1f} se {1e6 * f.sliding_distance_se:.2f} µm  "
                f"{f.reason}"
            )
    print(f"median {np.median(spent):.2f} s a recording of 14 pushes")


if __name__ == "__main__":
    main(*(kind(a) for kind, a in zip((int, float, float, float), sys.argv[1:], strict=False)))
