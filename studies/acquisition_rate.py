"""How fast `acquire` is, and what it costs: through the real nifpga, against the emulated card.

    python -m studies.acquisition_rate                 # virtual clock: as fast as the host can
    python -m studies.acquisition_rate --seconds 600   # real clock: 200 kHz, as a card sends them
    python -m studies.acquisition_rate --answers 3     # from a push's end to its mu_s, 3 a speed

A sample is a force word and a position word. All go into a fresh .tdms file, which is then read
back and compared, and removed.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import tempfile
import threading
import time
from pathlib import Path

import jax
import numpy as np

from difffric.acquisition.card import split_position
from difffric.acquisition.push import Command
from difffric.acquisition.recorder import acquire
from difffric.commands.reports.acquire import PAPER_SPEEDS_MM_MIN, Run, plan_commands, record
from difffric.measurements.files.tdms_reader import read_recordings
from difffric.rig.setup import Setup
from difffric.rig.setup_toml import read_setup
from difffric.studies.simulated_rig import make_simulated_card
from fpga.emulator.emulator import emulated_card

RATE = 200_000
PIECE = 40_000  # samples of the push that is played over and over: 0.2 s


def piece() -> tuple[np.ndarray, np.ndarray]:
    """Force words and encoder counts of a push: a half-wave with noise, and a travel."""
    random, s = np.random.default_rng(0), np.linspace(0.0, 1.0, PIECE)
    force = 8000 * np.sin(np.pi * np.clip(5 * s - 1, 0, 1)) + random.normal(0, 18, PIECE)
    return np.rint(force).astype(int), np.rint(1e5 * np.clip(s, 0.2, 0.9)).astype(int)


def memory() -> float:
    """What this process holds now [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def streamed(path: Path, repeats: int, real: bool) -> dict:
    """One push of many samples into `path`: how long, at which cost, and whether all are there."""
    words, counts = piece()
    grown: list[float] = []
    over = threading.Event()

    def watch():
        while not over.wait(1.0):
            grown.append(memory())

    with emulated_card(rate=RATE, real=real) as card:
        card.add_push(words, counts, repeats=repeats)
        with card.open() as session:
            watcher = threading.Thread(target=watch)
            watcher.start()
            before, began = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
            try:
                (push,) = acquire(session, [Command(0.05, 2e-3)], path)
            finally:
                took = time.perf_counter() - began
                after = resource.getrusage(resource.RUSAGE_SELF)
                over.set()
                watcher.join()
    user, system = after.ru_utime - before.ru_utime, after.ru_stime - before.ru_stime
    return {
        "samples": push.samples, "lost": push.lost, "took": took, "cpu": user + system,
        "agrees": push.hardware.agrees, "memory": grown, "whole": whole(path, words, counts),
    }  # fmt: skip


def whole(path: Path, words, counts) -> bool:
    """Whether the file holds just what was played."""
    (push,) = read_recordings(path)
    assert push.force is not None and push.position is not None
    for lo in range(0, push.force.n, PIECE):
        force, position = (c.read(lo, lo + PIECE) for c in (push.force, push.position))
        if not np.array_equal(np.rint(force * 2**15 / 10), words):
            return False
        if not np.array_equal(np.rint(position / 2e-8), counts):
            return False
    return True


def words_of(setup: Setup, pushes: list[Command], rate: int) -> list[tuple]:
    """Force words and encoder counts of pushes of a set-up's rig, as a card makes them."""
    simulated, _ = make_simulated_card(setup, float(rate), 3)
    simulated.state |= {"quiet_samples": rate // 50, "rest_samples": rate // 33}
    words = []
    for one in pushes:
        simulated.state["velocity_nm_per_s"] = round(one.velocity * 1e9)
        simulated.state["stroke_nm"] = round(one.stroke * 1e9)
        force, position = simulated._digitise()
        words.append((force, split_position(position)[1]))
    return words


def answered(setup: Setup, pushes: list[Command], rate: int, folder: Path) -> Run:
    """Pushes of the set-up's rig on the real clock, identified as they come."""
    words = words_of(setup, pushes, rate)
    with emulated_card(rate=rate, real=True) as card:
        for push in words:
            card.add_push(*push)
        with card.open() as session:
            return record(session, pushes, folder, setup=setup, quiet=True)


def show_answers(times: int) -> None:
    """How long the answers take."""
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    setup = read_setup("examples/setup.toml")
    stroke = setup.rig.pusher.stroke
    pushes = plan_commands(times * PAPER_SPEEDS_MM_MIN, stroke=stroke, mass=float(setup.rig.mass))
    with tempfile.TemporaryDirectory() as folder:
        run = answered(setup, pushes, RATE, Path(folder))
    after = {}
    for one in run.found:
        assert one is not None and one.friction is not None
        after.setdefault(one.acquired.command.velocity, []).append(1e3 * one.seconds)
    for velocity, ms in after.items():
        print(f"{60e3 * velocity:5.0f} mm/min: {', '.join(f'{x:.0f}' for x in ms)} ms")
    every = [x for ms in after.values() for x in ms]
    print(
        f"{len(every)} pushes at {RATE / 1e3:g} kHz: median {statistics.median(every):.0f} ms, "
        f"at most {max(every):.0f} ms; within 50 ms: {sum(x <= 50 for x in every)}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="how fast `acquire` is, and what it costs")
    parser.add_argument("--seconds", type=float, help="of real time; none: the virtual clock")
    parser.add_argument("--samples", type=float, default=1e8, help="with the virtual clock")
    parser.add_argument("--runs", type=int, default=3, help="with the virtual clock")
    parser.add_argument("--folder", type=Path, help="where the file goes")
    parser.add_argument("--answers", type=int, help="pushes of each speed, to be identified")
    given = parser.parse_args()
    if given.answers:
        show_answers(given.answers)
        return
    real = given.seconds is not None
    samples = given.seconds * RATE if real else given.samples
    found = []
    for _ in range(1 if real else given.runs):
        with tempfile.TemporaryDirectory(dir=given.folder) as folder:
            one = streamed(Path(folder) / "pushes.tdms", max(round(samples / PIECE), 1), real)
        found.append(one)
        print(
            f"{one['samples']} samples in {one['took']:.2f} s: "
            f"{one['samples'] / one['took'] / 1e6:.2f} M/s; processor {one['cpu']:.2f} s, "
            f"{100 * one['cpu'] / one['took']:.1f} % of a core; lost {one['lost']}; "
            f"file as played: {one['whole']}; the card agrees: {one['agrees']}",
            flush=True,
        )
        if len(held := one["memory"]) > 10:  # by then the FIFOs' 10 MB have all been used
            print(
                f"memory: {held[1]:.1f} MB after 2 s, {held[9]:.1f} MB after 10 s, "
                f"{held[-1]:.1f} MB at the end, at most {max(held):.1f} MB"
            )
    if not real:
        rates = [one["samples"] / one["took"] / 1e6 for one in found]
        print(f"median {statistics.median(rates):.1f} M samples/s")


if __name__ == "__main__":
    main()
