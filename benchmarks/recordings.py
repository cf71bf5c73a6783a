"""The fit of 14 recordings of 200 kHz: cold, warm, and the memory it takes.

    python -m benchmarks.recordings

A fresh process simulates the recordings apart from the library, and fits them twice with an empty
compilation cache: the first time all is compiled. The peak counts the whole process, the samples
and what simulated them included.
"""

from __future__ import annotations

import os
import resource
import sys
import time

os.environ["JAX_ENABLE_X64"] = "1"
os.environ.pop("JAX_COMPILATION_CACHE_DIR", None)
os.environ.setdefault("EQX_ON_ERROR", "nan")

import numpy as np

import difffric as df
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.rig.sensors import ForceSensor
from tests.reference import data as reference

RATE = 2e5
"""[Hz]"""
REST = 0.105
"""[s] after the part has stopped: 0.2 s a recording on average"""
ROUGH = {"mu_s": 0.2, "k": 4e5, "b": 3000.0, "k_v": 5.0}


def recordings() -> tuple[float, Recordings]:
    """The part's mass [kg], and the 14 recordings."""
    rig = reference.Rig(
        m=18.9, mu_s=0.14, ratio=0.75, k_v=6.0, k=8.2e5, b=1600.0, scatter=0.02, stroke=None,
        push_time=0.035,
    )  # fmt: skip
    rng = np.random.default_rng(5)
    made = []
    for push in reference.make_pushes(rig, rng):
        x = reference.record(push, rng, rate=RATE, after=REST)
        force = Channel.of(x.force, x.dt, x.start, "N")
        position = Channel.of(x.position, x.dt, x.start, "m")
        made.append(
            Recording(velocity=push.velocity, force=force, position=position, stroke=push.stroke)
        )
    return rig.m, Recordings(tuple(made))


def main() -> None:
    mass, data = recordings()
    rough = df.spring_damper_rig(mass=mass, force_sensor=ForceSensor(range=5000.0), **ROUGH)
    samples = [r.force.n for r in data if r.force is not None]
    print(f"{len(data)} recordings, {np.mean(samples):.0f} samples a channel on average")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    for name in ("cold", "warm"):
        began = time.perf_counter()
        fit = df.fit(rough, data)
        print(f"{name}: {time.perf_counter() - began:.2f} s, reduced chi2 {fit.reduced_chi2:.3f}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"peak memory: {peak:.2f} GB ({before:.2f} GB before the first fit)")


if __name__ == "__main__":
    sys.exit(main())
