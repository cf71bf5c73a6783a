"""What a sampling rate costs: F_p, d and mu_s of the paper's rig, from samples of exact pushes.

    python -m studies.sampling [--page PAGE] [--image IMAGE]

The tables are printed and set between two marks of the page; the figure is drawn beside it. Every
number is that of many runs over the same push, at phases that fill a sampling interval evenly; all
that is random has a fixed seed.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import difffric as df
from difffric.measurements.recordings import Channel, Recording
from difffric.measurements.reduction.reduce import reduce_push
from difffric.rig import parameters
from difffric.studies import paper
from difffric.studies.sampling import (
    DSP,
    FPGA,
    SampledPush,
    Sampler,
    estimate_friction,
    mean_loss,
    sample_push,
)
from difffric.units import from_mm_min, from_um, to_um
from studies import runs

PAGE = runs.ROOT / "docs" / "sampling.md"
IMAGE = runs.ROOT / "docs" / "images" / "sampling_rate.png"
COMMAND = "python -m studies.sampling"
RATES = (1 / 1010e-6, 2e3, 5e3, 10e3, 20e3, 50e3, 100e3, 200e3)
SPEEDS = (500, 1000, 2000, 3000, 4000, 5000)
"""[mm/min], of the paper's tables"""
SPEED = 3000
MU_S = 0.141
RUNS, PARTS = 2000, 4
"""over the same push, and how many groups of them are in memory one after another"""
NOISE, THRESHOLD = 0.5, 2.5
"""[N]: of a sample, and five times that"""
NOISE_POSITION = from_um(0.3)
AVERAGED = 0.3e-3
"""[s] that a running mean before the peak hold runs over"""
REDUCED = 40
"""noisy recordings a rate; their reduction takes most of the time"""


class Errors(NamedTuple):
    """Of F_p [N] and d [m], (runs,) each; of mu_s relative to the truth."""

    force: np.ndarray
    distance: np.ndarray
    mu_s_force: np.ndarray
    mu_s_distance: np.ndarray


def rig_of_the_examples():
    """k, b and k_v near what the paper's own fits imply."""
    return df.spring_damper_rig(mass=18.9, mu_s=MU_S, k=8.0e5, b=1500.0, k_v=5.0)


def calibrated_rig():
    """k, b and k_v by the paper's tables, distances that no rebound gives left out."""
    measured = paper.load_pushes()
    impossible = measured.sliding_distance > paper.bound_distance(measured)
    reachable = np.where(impossible, np.nan, measured.sliding_distance)
    fit = df.fit(paper.guess_rig(), replace(measured, sliding_distance=reachable))
    return parameters.with_values(fit.rig, {"mu_s": MU_S})


def errors(rig, speed: float, sampler: Sampler, **options) -> Errors:
    """Of RUNS runs at a speed [mm/min]."""
    velocity, phase = from_mm_min(float(speed)), (np.arange(RUNS) + 0.5) / RUNS
    push = df.simulate(rig, velocity)
    parts = [sample_push(push, sampler, phase[i::PARTS], seed=i, **options) for i in range(PARTS)]
    seen = SampledPush(*map(np.concatenate, zip(*parts, strict=True)))
    return Errors(
        seen.peak_force - float(push.peak_force),
        seen.sliding_distance - float(push.sliding_distance),
        *(mu_s / MU_S - 1 for mu_s in estimate_friction(rig, velocity, seen)),
    )


def rms(relative) -> float:
    """Root mean square of relative errors; a value that no mu_s gives counts as 100 %."""
    return float(np.sqrt(np.mean(np.square(np.where(np.isnan(relative), 1.0, relative)))))


def kinds(rate: float) -> dict[str, Sampler]:
    """The same rate without disturbance, and with a DSP's."""
    return {
        "regular": Sampler(rate),
        "jitter": Sampler(rate, jitter=DSP.jitter),
        "held up": replace(DSP, rate=rate),
    }


def cards() -> dict[str, Sampler]:
    """What the paper compares."""
    return {
        "DSP, never held up": replace(DSP, held=0.0),
        "DSP, 5 % held up": DSP,
        "DSP, 20 % held up": replace(DSP, held=0.2),
        "FPGA": FPGA,
    }


class Noisy(NamedTuple):
    """Errors with noise at one rate, each (runs,)."""

    largest: Errors
    averaged: np.ndarray
    """of the largest running mean [N]; empty where that is one of one sample"""
    force: np.ndarray
    """of F_p as a reduced recording says it [N]"""
    distance: np.ndarray
    """of its d [m]"""


def noisy(rig, rate: float) -> Noisy:
    """At SPEED, with white noise."""
    velocity = from_mm_min(float(SPEED))
    push, random = df.simulate(rig, velocity), np.random.default_rng(1)
    end, window = float(push.stop_time) + 0.03, round(AVERAGED * rate)
    averaged, reduced = [], []
    for i in range(REDUCED):
        first = -int(0.02 * rate)
        t = (first + np.arange(int(end * rate) - first) + (i + 0.5) / REDUCED) / rate
        force, position, _ = map(np.asarray, push.evaluate(t))
        force = force + NOISE * random.standard_normal(t.size)
        position = position + NOISE_POSITION * random.standard_normal(t.size)
        if window > 1:
            averaged.append(np.convolve(force, np.ones(window) / window, "valid").max())
        channels = ((force, "N"), (position, "m"))
        found = reduce_push(
            Recording(velocity, *(Channel.of(x, 1 / rate, t[0], unit) for x, unit in channels))
        )
        reduced.append((found.peak_force, found.sliding_distance))
    F_p, d = np.array(reduced).T
    return Noisy(
        errors(rig, SPEED, Sampler(rate), noise=NOISE, threshold=THRESHOLD),
        np.array(averaged) - float(push.peak_force),
        F_p - float(push.peak_force),
        d - float(push.sliding_distance),
    )


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A markdown table."""
    return "\n".join("| " + " | ".join(r) + " |" for r in (head, ["---"] * len(head), *rows))


def percent(x: float) -> str:
    """Two digits of a relative error."""
    return f"{100 * x:.2g}" if 1e-6 <= x < 0.1 else f"{100 * x:.0f}" if x > 0.1 else "< 0.0001"


def mN(x: float) -> str:
    return f"{1e3 * x:.0f}" if x >= 0.1 else f"{1e3 * x:.2g}"


def spread(x, digits: int) -> str:
    """Mean and standard deviation."""
    return f"{np.mean(x):+.{digits}f} ± {np.std(x):.{digits}f}"


def khz(rate: float) -> str:
    return f"{rate / 1e3:.3g}"


def sweep(rig) -> dict[tuple[float, int, str], Errors]:
    """(rate, speed, kind) -> errors; the disturbed kinds at SPEED only."""
    return {
        (rate, speed, kind): errors(rig, speed, sampler)
        for rate in RATES
        for speed in SPEEDS
        for kind, sampler in kinds(rate).items()
        if kind == "regular" or speed == SPEED
    }


def rate_table(rig, found) -> str:
    """What is lost at SPEED."""
    push, rows = df.simulate(rig, from_mm_min(float(SPEED))), []
    for rate in RATES:
        each = [found[rate, SPEED, kind] for kind in kinds(rate)]
        regular = each[0]
        rows.append(
            [
                khz(rate),
                f"{mN(-regular.force.mean())} ({mN(mean_loss(push, rate))})",
                mN(-regular.force.min()),
                f"{-to_um(regular.distance.mean()):.2g}",
                " / ".join(percent(rms(x.mu_s_force)) for x in each),
                " / ".join(percent(rms(x.mu_s_distance)) for x in each),
            ]
        )
    head = ["kHz", "`F_p` too low [mN], mean (by the formula)", "at most", "`d` too short [µm]"]
    return table([*head, "`mu_s` from `F_p` [%]", "`mu_s` from `d` [%]"], rows)


def speed_table(found) -> str:
    """The undisturbed errors of mu_s at every speed."""
    rows = []
    for rate in RATES:
        each = [found[rate, speed, "regular"] for speed in SPEEDS]
        cells = (f"{percent(rms(x.mu_s_force))} / {percent(rms(x.mu_s_distance))}" for x in each)
        rows.append([khz(rate), *cells])
    return table(["kHz", *(f"{speed} mm/min" for speed in SPEEDS)], rows)


def card_table(rigs) -> str:
    """What the paper compares, at its speeds."""
    rows = []
    for name, rig in rigs.items():
        for speed in SPEEDS:
            cells = []
            for sampler in cards().values():
                found = errors(rig, speed, sampler)
                left = np.isfinite(found.distance).all()
                by_distance = percent(rms(found.mu_s_distance)) if left else "–"
                cells.append(f"{percent(rms(found.mu_s_force))} / {by_distance}")
            rows.append([name, str(speed), *cells])
    return table(["rig", "mm/min", *cards()], rows)


def noise_table(rig, found: dict[float, Noisy]) -> str:
    """What noise makes of it, at SPEED."""
    slope = float(df.sensitivity(rig, from_mm_min(float(SPEED))).peak_force["mu_s"])

    def by_force(error) -> str:
        if not len(error):
            return "–"
        relative = float(np.sqrt(np.mean(np.square(error)))) / (slope * MU_S)
        return f"{spread(error, 2)} ({percent(relative)})"

    rows = [
        [
            khz(rate),
            *(by_force(x) for x in (n.largest.force, n.averaged, n.force)),
            spread(to_um(n.largest.distance), 1),
            spread(to_um(n.distance), 1),
        ]
        for rate, n in found.items()
    ]
    head = ["kHz", "`F_p` [N]: largest sample", "largest mean of 0.3 ms", "reduced"]
    return table([*head, f"`d` [µm]: first sample below {THRESHOLD} N", "reduced"], rows)


def draw(path: Path, rig, found, with_noise: dict[float, Noisy]) -> None:
    """The figure of the page."""
    figure, axes = plt.subplots(1, 3, figsize=(12.6, 4.0), layout="constrained")
    rates = np.array(RATES)
    for speed, colour in ((5000, "C3"), (3000, "C1"), (500, "C0")):
        lost = [-found[rate, speed, "regular"].force for rate in RATES]
        push = df.simulate(rig, from_mm_min(float(speed)))
        formula = [mean_loss(push, rate) for rate in RATES]
        axes[0].plot(rates, [x.max() for x in lost], ":", color=colour, lw=1.0)
        axes[0].plot(
            rates, [x.mean() for x in lost], "o", ms=4, color=colour, label=f"{speed} mm/min"
        )
        axes[0].plot(rates, formula, color=colour, lw=1.0)
    axes[0].plot([], [], ":", color="0.3", lw=1.0, label="worst phase")
    axes[0].plot([], [], color="0.3", lw=1.0, label="mean by the formula")
    axes[0].set(ylabel="$F_p$ too low [N]", title="the largest sample")
    styles = {"regular": "-", "jitter": "--", "held up": ":"}
    texts = {"jitter": "30 µs of jitter", "held up": "and held up 5 %"}
    for way, colour, name in (("mu_s_force", "C0", "$F_p$"), ("mu_s_distance", "C2", "d")):
        for kind, dashes in styles.items():
            y = [100 * rms(getattr(found[rate, SPEED, kind], way)) for rate in RATES]
            label = f"from {name}, {texts.get(kind, kind)}"
            axes[1].plot(rates, y, dashes, marker="o", ms=3, color=colour, label=label)
    axes[1].set(ylabel="error of $\\mu_s$ [%], rms", title=f"{SPEED} mm/min, without noise")
    ways = {
        "largest sample": ("C3", lambda n: n.largest.force),
        "largest mean of 0.3 ms": ("C4", lambda n: n.averaged),
        "reduced": ("C2", lambda n: n.force),
    }
    for i, (name, (colour, of)) in enumerate(ways.items()):
        there = {rate: of(n) for rate, n in with_noise.items() if len(of(n))}
        mean, sd = [e.mean() for e in there.values()], [e.std() for e in there.values()]
        x = np.array(list(there)) * 1.06 ** (i - 1)
        axes[2].errorbar(x, mean, sd, fmt="o-", ms=3, lw=1.0, color=colour, label=name)
    axes[2].axhline(0, color="0.3", lw=0.8)
    title = f"{SPEED} mm/min, {NOISE} N of noise"
    axes[2].set(ylabel="$F_p$ less the exact peak [N]", title=title)
    for ax in axes:
        ax.set(xscale="log", xlabel="samples a second")
        ax.grid(which="major", color="0.9", lw=0.6)
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(frameon=False, fontsize=8)
    for ax in axes[:2]:
        ax.set_yscale("log")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def named(rig) -> str:
    """k and b, as the tables say them."""
    values = parameters.values(rig)
    k, b = float(values["k_N_per_m"]), float(values["b_N_s_per_m"])
    return f"k = {k / 1e5:.2f}e5, b = {b:.0f}"


def markdown(rig, found, compared: str, with_noise: dict[float, Noisy]) -> str:
    """What stands between the page's marks."""
    jitter, longest = f"{1e6 * DSP.jitter:.0f} µs", f"{1e3 * DSP.longest:.0f} ms"
    return "\n\n".join(
        [
            f"`{COMMAND}`. {RUNS} runs over each push, at phases that fill a sampling interval "
            f"evenly; {named(rig)}. Errors of `mu_s` are root mean squares, relative to the truth; "
            "a force that no `mu_s` gives counts as 100 %.",
            f"**At {SPEED} mm/min**, without noise. `mu_s`: regular / {jitter} of jitter / jitter "
            f"and {100 * DSP.held:.0f} % of the time held up, for up to {longest} each.",
            rate_table(rig, found),
            "**At the paper's speeds**, regular samples without noise: `mu_s` from `F_p` / from "
            "`d` [%].",
            speed_table(found),
            f"**The paper's two cards**: `mu_s` from `F_p` / from `d` [%]. The DSP's samples have "
            f"{jitter} of jitter; it is held up for up to {longest} each.",
            compared,
            f"**With noise**, at {SPEED} mm/min: {NOISE} N and {to_um(NOISE_POSITION):.1f} µm, "
            f"white. Mean and standard deviation of the error; in brackets, that of `mu_s` [%]. "
            f"{REDUCED} recordings for each mean and reduction.",
            noise_table(rig, with_noise),
        ]
    )


def main(words: Sequence[str] | None = None) -> int:
    """Print the tables, write them into the page, draw the figure."""
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--image", type=Path, default=IMAGE)
    asked = parser.parse_args(words)
    jax.config.update("jax_enable_x64", True)
    rig, fitted = rig_of_the_examples(), calibrated_rig()
    found, with_noise = sweep(rig), {rate: noisy(rig, rate) for rate in RATES}
    compared = card_table({named(rig): rig, f"calibrated: {named(fitted)}": fitted})
    text = markdown(rig, found, compared, with_noise)
    print(text)
    runs.write_into(asked.page, text, "sampling")
    draw(asked.image, rig, found, with_noise)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
