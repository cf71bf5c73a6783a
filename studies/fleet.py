"""What docs/fleet.md says of speed and of kills, measured: made recordings and tables of many rigs.

    python -m studies.fleet FOLDER --recordings 10000 --rows 1000000 --kills 20 --workers 2

Times are by the clock and, as other work may share the machine, of all processors; those of stages
leave out what starts the workers. Programs are kept in FOLDER, and made before the clock starts.
All numbers are of one run.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from nptdms import TdmsFile

from tests.reference import data, files

ROOT = Path(__file__).parents[1]
ENVIRONMENT = {
    "JAX_ENABLE_X64": "1",
    "JAX_PLATFORMS": "cpu",
    "EQX_ON_ERROR": "nan",
    "JAX_CPU_ENABLE_ASYNC_DISPATCH": "0",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NPROC": "1",
}


def a_rig(rng: np.random.Generator, stroke: float | None) -> data.Rig:
    """A random rig whose pushes are short and stay below the sensor's range."""
    rig = replace(data.random_rig(rng), stroke=stroke, push_time=None, scatter=0.02)
    return replace(rig, m=min(rig.m, 15.0), k=min(rig.k, 1e6), k_v=5.0)


def make_recordings(folder: Path, n: int, rigs: int = 20, rate: float = 10e3, seed: int = 1):
    """n files of one push each, of half as many rigs with a stroke as without."""
    rng = np.random.default_rng(seed)
    for r in range(rigs):
        rig = a_rig(rng, None if r % 3 else 2e-3)
        place = folder / f"rig{r:02d}"
        place.mkdir(parents=True, exist_ok=True)
        files.write_setup(place / "setup.toml", rig, force_range=2e3)
        for i, push in enumerate(data.make_pushes(rig, rng, n // rigs)):
            one = data.record(push, rng, rate=rate)
            path = place / f"{i:05d}.tdms"
            files.write_recordings(path, [one])
            day = 1_790_000_000 + 86400 * (i * 30 * rigs // n)
            os.utime(path, (day, day))


def make_tables(folder: Path, rows: int, stroke: float | None, rigs: int = 20, seed: int = 2):
    """A table a rig, of pushes at the usual speeds, each with its own mu_s and errors. 500 are
    followed for each rig, and read off again and again."""
    rng = np.random.default_rng(seed)
    for r in range(rigs):
        rig, n = a_rig(rng, stroke), rows // rigs
        place = folder / f"rig{r:02d}"
        place.mkdir(parents=True, exist_ok=True)
        files.write_setup(place / "setup.toml", rig)
        pushes = data.make_pushes(rig, rng, 500)
        parts = [data.measure(pushes, rng) for _ in range(-(-n // 500))]
        columns = {k: np.concatenate([p[k] for p in parts])[:n] for k in parts[0]}
        columns["order"] = np.arange(1.0, n + 1)
        files.write_table(place / "pushes.csv", columns, omit=["stroke_mm"])


def by_nptdms(paths: list[str]) -> float:
    """Every sample of the files, by npTDMS as its manual reads a file; the sum of them all."""
    total = 0.0
    for path in paths:
        for group in TdmsFile.read(path).groups():
            for channel in group.channels():
                total += float(np.sum(channel[:]))
    return total


def by_difffric(paths: list[str]) -> float:
    """Every sample of the files by this library, with its checks; the number of pushes."""
    from difffric.measurements.checks import check_data
    from difffric.measurements.files.tdms_reader import read_recordings
    from difffric.rig.setup_toml import read_setup

    rigs: dict[Path, object] = {}
    pushes = 0
    for path in paths:
        folder = Path(path).parent
        rig = rigs.setdefault(folder, None) or read_setup(folder / "setup.toml").rig
        rigs[folder] = rig
        pushes += len(check_data(read_recordings(path), rig, skip_bad=True))
    return pushes


def timed(job: tuple[Callable, list[str]]) -> float:
    """Processor time [s] of a share of the files."""
    start = time.process_time()
    job[0](job[1])
    return time.process_time() - start


def spread(function: Callable, paths: list[str], n: int) -> dict[str, float]:
    """Seconds for the files, dealt out to n spawned processes that are ready: by the clock, and of
    all their processors."""
    with get_context("spawn").Pool(n) as pool:
        pool.map(timed, [(function, paths[i : i + 1]) for i in range(n)], chunksize=1)  # imported
        start = time.perf_counter()
        spent = pool.map(timed, [(function, paths[i::n]) for i in range(n)], chunksize=1)
        return {"clock": time.perf_counter() - start, "processors": sum(spent)}


def fleet(archive: Path, out: Path, n: int) -> dict[str, float]:
    """Seconds of the stages of one run."""
    from difffric.fleet.identify_archive import identify_fleet

    marks: dict[str, list[float]] = {}

    def tell(what: str, share: float) -> None:
        marks.setdefault(what.split(",")[0], []).append(time.perf_counter())

    start, before = time.perf_counter(), sum(os.times()[:4])
    found = identify_fleet(archive, out, n_workers=n, tell=tell)
    end, spent = time.perf_counter(), sum(os.times()[:4]) - before
    read = marks.get("reading recordings", [start])
    seen = marks.get("identifying", [end])
    return {
        "all": end - start,
        "processors": spent,
        "until_first_features": read[0] - start,
        "features": read[-1] - read[0],
        "until_first_friction": seen[0] - read[-1],
        "friction": seen[-1] - seen[0],
        "end": end - seen[-1],
        "fresh_files": found.fresh_files,
        "fresh_parts": found.fresh_parts,
        "bad": len(found.bad),
    }


def warm(archive: Path, at: Path, n: int) -> None:
    """Have the programs for an archive of tables made: identify the first rows of each."""
    shutil.rmtree(at, ignore_errors=True)
    for path in archive.rglob("*.csv"):
        place = at / "archive" / path.parent.name
        place.mkdir(parents=True)
        shutil.copy(path.parent / "setup.toml", place)
        with open(path) as whole:
            (place / path.name).write_text("".join(islice(whole, 600)))
    fleet(at / "archive", at / "out", n)


def tree(folder: Path) -> dict[str, bytes]:
    """What a run left, but for its state."""
    paths = (p for p in sorted(folder.rglob("*")) if p.is_file() and ".fleet" not in p.parts)
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in paths}


def command(archive: Path, out: Path, n: int) -> subprocess.Popen:
    call = ["identify", str(archive), "--out", str(out), "--workers", str(n), "--quiet"]
    return subprocess.Popen(
        [sys.executable, "-m", "difffric.commands.main", *call], cwd=ROOT, stdout=subprocess.DEVNULL
    )


def children(pid: int) -> list[int]:
    """Worker processes of a run."""
    import psutil

    try:
        below = psutil.Process(pid).children(recursive=True)
        return [p.pid for p in below if "spawn_main" in " ".join(p.cmdline())]
    except psutil.Error:
        return []


def kills(archive: Path, folder: Path, n: int, times: int, longest: float) -> dict[str, int]:
    """Runs whose workers, and then runs that themselves, are killed at random moments; how many
    kills hit, and how often what is left at last differed from that of a run left alone."""
    draw = random.Random(3)
    assert command(archive, folder / "whole", n).wait() == 0
    whole = tree(folder / "whole")
    hit = {"workers_killed": 0, "runs_killed": 0, "different": 0}
    for k in range(times):
        out = folder / f"killed{k}"
        by_worker = k % 2 == 0
        while True:
            run = command(archive, out, n)
            time.sleep(draw.uniform(0.3, 1.0) * longest)
            if run.poll() is not None:
                break
            if by_worker and (own := children(run.pid)):
                os.kill(draw.choice(own), signal.SIGKILL)
                hit["workers_killed"] += 1
                break
            run.kill()
            run.wait()
            hit["runs_killed"] += 1
            if draw.random() < 0.3:
                break
        if run.wait() != 0:
            assert command(archive, out, n).wait() == 0
        hit["different"] += tree(out) != whole
    return hit


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("folder", type=Path)
    for name in ("recordings", "rows", "rows_with_stroke", "kills", "rate"):
        options.add_argument(f"--{name.replace('_', '-')}", type=int, default=0)
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--longest", type=float, default=20.0, help="a run of the kills [s]")
    given = options.parse_args()
    for name, x in ENVIRONMENT.items():
        os.environ.setdefault(name, x)
    n, at = given.workers, given.folder
    at.mkdir(parents=True, exist_ok=True)
    os.environ["DIFFFRIC_PROGRAMS"] = str((at / "programs").absolute())
    if given.recordings:
        archive = at / "recordings"
        if not archive.exists():
            make_recordings(archive, given.recordings, rate=given.rate or 10e3)
        paths = sorted(map(str, archive.rglob("*.tdms")))
        size = sum(os.path.getsize(p) for p in paths)
        told = {"files": len(paths), "bytes": size}
        told["npTDMS"] = spread(by_nptdms, paths, n)
        told["read_and_checked"] = spread(by_difffric, paths, n)
        told["fleet"] = fleet(archive, at / "out_recordings", n)
        told["again"] = fleet(archive, at / "out_recordings", n)["all"]
        print(json.dumps(told, indent=1), flush=True)
    for rows, stroke in ((given.rows, None), (given.rows_with_stroke, 2e-3)):
        if rows:
            archive = at / f"tables_{'with' if stroke else 'without'}_stroke_{rows}"
            if not archive.exists():
                make_tables(archive, rows, stroke)
            warm(archive, at / "few_rows", n)
            told = fleet(archive, at / f"out_{archive.name}", n)
            print(json.dumps({"rows": rows, "stroke": stroke, **told}, indent=1), flush=True)
    if given.kills:
        archive = at / "few"
        if not archive.exists():
            make_recordings(archive, 200, rigs=4)
        print(json.dumps(kills(archive, at / "kills", n, given.kills, given.longest)), flush=True)


if __name__ == "__main__":
    main()
