"""A fleet: each push's mu_s is `identify`'s, whatever ran it, and however often it was killed."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from nptdms import TdmsFile, TdmsWriter

import difffric as df
from difffric.fleet import features, identify_archive, workers
from difffric.fleet.archive import find_files
from difffric.fleet.columns import identify_columns
from difffric.fleet.identify_archive import data_set, identify_fleet
from difffric.identification.estimates import WAYS
from difffric.rig.setup_toml import read_setup
from studies.fleet import children, kills, tree
from tests.reference import data, files

ROOT = Path(__file__).parents[3]
RIGS = {
    "hall/a": data.Rig(12.0, 0.14, 0.75, 5.0, 6e5, 900.0, scatter=0.02),
    "hall/b": data.Rig(9.0, 0.11, 0.75, 3.0, 9e5, 700.0, scatter=0.02),
}
SPEEDS = tuple(data.MM_MIN * v for v in (2000, 3000, 4000))
DAY = 1_790_000_000  # 2026-09-21


def write(path, rig, seed, n=2):
    """A recording of n pushes."""
    rng = np.random.default_rng(seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    recorded = [data.record(p, rng) for p in data.make_pushes(rig, rng, n, SPEEDS)]
    files.write_recordings(path, recorded)
    os.utime(path, (DAY, DAY))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two rigs, three recordings and a table each, a file that is none, a table with a bad row."""
    top = tmp_path_factory.mktemp("fleet") / "archive"
    for r, (name, rig) in enumerate(RIGS.items()):
        for i in range(3):
            write(top / name / f"day{i}" / "pushes.tdms", rig, 10 * r + i)
        files.write_setup(top / name / "setup.toml", rig)
        rng = np.random.default_rng(r)
        columns = data.measure(data.make_pushes(rig, rng, 5, SPEEDS), rng)
        files.write_table(top / name / "table.csv", columns)
    (top / "hall/b/broken.tdms").write_bytes(b"no recording")
    with open(top / "hall/b/table.csv", "a") as file:
        file.write("fast,1,1,9.0,A,6,0.5,0.3\n")
    for name in RIGS:
        os.utime(top / name / "table.csv", (DAY, DAY))
    return top


@pytest.fixture
def archive(made, tmp_path):
    """A copy of it, times kept."""
    return Path(shutil.copytree(made, tmp_path / "archive"))


@pytest.fixture(scope="module")
def whole(made, tmp_path_factory):
    """An undisturbed run."""
    out = tmp_path_factory.mktemp("fleet") / "out"
    return identify_fleet(made, out)


def close(found, expected, tolerance=1e-12):
    both = np.isnan(found) == np.isnan(expected)
    return both.all() and np.nanmax(np.abs(found / expected - 1), initial=0.0) <= tolerance


def columns_are_those_of_identify(setup, pushes):
    """Estimates, standard errors and what stands beside them agree."""
    table, answers = identify_columns([(setup, pushes)])[0], df.identify(setup, pushes)
    for way in list(WAYS)[:-1]:
        assert close(table[way].to_numpy(), answers.values(way)), way
        assert close(table[f"{way}_se"].to_numpy(), answers.standard_errors(way)), way
    assert table["regime"].to_list() == [p.regime for p in answers]
    assert table["disagreement"].is_null().to_list() == [p.disagreement is None for p in answers]
    assert [tuple(x or ()) for x in table["alternatives"].to_list()] == [
        p.alternatives for p in answers
    ]
    assert table["reason"].is_null().to_list() == [p.reason is None for p in answers]
    best = [p.best.value for p in answers]
    assert close(table["mu_s"].to_numpy(), np.array(best, float))


def uncertain(path):
    """The set-up at `path`, its stiffness and viscosity known with errors."""
    text = path.read_text().replace("k_N_per_m = ", "k_N_per_m = { standard_error = 5e3, value = ")
    text = text.replace("k_v_N_s_per_m = ", "k_v_N_s_per_m = { standard_error = 0.4, value = ")
    lines = [x + " }" if "standard_error = " in x else x for x in text.splitlines()]
    path.write_text("\n".join(lines))
    return read_setup(path)


@pytest.mark.parametrize("stroke", [None, 2e-3], ids=["without_stroke", "with_stroke"])
def test_each_row_is_what_identify_says(tmp_path, stroke):
    rng = np.random.default_rng(5)
    rig = replace(RIGS["hall/a"], stroke=stroke)
    files.write_setup(tmp_path / "setup.toml", rig)
    setup = uncertain(tmp_path / "setup.toml")
    c = data.measure(data.make_pushes(rig, rng, 12), rng)
    force, d = c["peak_force"].copy(), c["sliding_distance"].copy()
    force[0], d[1], d[2], force[3] = np.nan, np.nan, 0.9, 1.0  # not measured; not possible
    pushes = df.Pushes(
        velocity=c["velocity"], peak_force=force, sliding_distance=d,
        peak_force_se=np.where(np.arange(12) < 6, 0.4, np.nan),
        release_velocity=0.9 * c["velocity"],
    )  # fmt: skip
    columns_are_those_of_identify(setup, pushes)


def test_free_slides_are_what_identify_says(tmp_path):
    rng, rig = np.random.default_rng(6), RIGS["hall/a"]
    files.write_setup(tmp_path / "setup.toml", rig)
    c = data.measure_slides(rig, rng, 8).columns
    slides = df.Pushes(
        release_velocity=c["release_velocity"], release_velocity_se=c["release_velocity_se"],
        sliding_distance=c["sliding_distance"],
    )  # fmt: skip
    columns_are_those_of_identify(uncertain(tmp_path / "setup.toml"), slides)


def test_no_push_depends_on_those_beside_it(whole):
    """A rig's pushes, alone and among others', one at a time and together: the same bits."""
    table = whole.pushes.collect()
    parts = {}
    for name, rows in table.group_by("rig", maintain_order=True):
        setup = read_setup(
            next(iter(whole.folder.parent.parent.glob(f"*/archive/{name[0]}/setup.toml")))
        )
        parts[name[0]] = setup, identify_archive.features.to_pushes(rows)
    together = pl.concat(identify_columns(list(parts.values())))
    single = [
        identify_columns([(s, p.select([i]))])[0] for s, p in parts.values() for i in range(len(p))
    ]
    assert together.equals(pl.concat(single))


def test_the_data_set_holds_what_identify_finds_in_each_file(made, whole):
    table = whole.pushes.collect()
    assert len(table) == 2 * (3 * 2 + 5)
    for (file,), rows in table.group_by("file"):
        rig = rows["rig"][0]
        assert file.startswith(f"{rig}/")
        found = df.identify(
            read_setup(made / rig / "setup.toml"),
            df.load(made / file, skip_bad=True),
            skip_bad=True,
        )
        assert close(rows["mu_s_optimal"].to_numpy(), found.values("mu_s_optimal"))
        assert close(rows["mu_s_optimal_se"].to_numpy(), found.standard_errors("mu_s_optimal"))
    truth = np.array([RIGS[rig].mu_s for rig in table["rig"]])
    assert abs(np.mean(table["mu_s"].to_numpy() / truth) - 1) < 0.02


def test_it_is_partitioned_by_rig_and_date(whole):
    """Readers of such data sets find both columns, and the rows, without this library."""
    seen = pl.read_parquet(whole.folder / "pushes/**/*.parquet", hive_partitioning=True)
    assert set(seen["rig"]) == set(RIGS) and set(map(str, seen["date"])) == {"2026-09-21"}
    assert len(seen) == len(whole.pushes.collect())
    assert {p.parent.name for p in whole.folder.glob("pushes/*/*/*")} == {"date=2026-09-21"}


def test_bad_files_and_pushes_are_listed_with_their_reasons(whole):
    assert [(rig, file) for rig, file, _ in whole.bad] == [("hall/b", "hall/b/broken.tdms")]
    assert "not a TDMS file" in whole.bad[0][2]
    assert [(rig, file) for rig, file, _ in whole.skipped] == [("hall/b", "hall/b/table.csv")]
    assert "'fast'" in whole.skipped[0][2]
    listed = pl.read_csv(whole.folder / "bad.csv")
    assert listed["left_out"].to_list() == ["file", "push"]


def test_two_processes_one_of_them_killed_give_the_same_bits(made, whole, tmp_path):
    """A worker is killed as soon as there is one that works."""
    code = (
        "import sys; from difffric import fleet\n"
        "if __name__ == '__main__':\n"
        "    fleet.FILES = fleet.ROWS = 1\n"
        "    fleet.identify_fleet(sys.argv[1], sys.argv[2], n_workers=2)\n"
    )
    (tmp_path / "run.py").write_text(code)
    out = tmp_path / "out"
    run = subprocess.Popen([sys.executable, tmp_path / "run.py", made, out], cwd=ROOT)
    killed = 0
    while run.poll() is None and not killed:
        time.sleep(0.02)
        if any((out / ".fleet").glob("*.parquet")) and (own := children(run.pid)):
            os.kill(own[-1], signal.SIGKILL)
            killed += 1
    assert run.wait(timeout=300) == 0 and killed
    rows, expected = data_set(out).collect(), whole.pushes.collect()
    assert rows.equals(expected)  # in other parts, as one row went into each


class Killed(BaseException):
    """What no `except Exception` stops."""


def test_a_run_cut_off_at_any_writing_ends_with_the_same_bits(made, whole, tmp_path, monkeypatch):
    """The first run dies before its first file takes its name, the next before its second, and so
    on; half of each such file is left, as a kill leaves it."""
    out, left, replace_file = tmp_path / "out", [0], os.replace

    def die(source, target):
        left[0] -= 1
        if left[0] < 0:
            torn = Path(source).with_name(f".{Path(target).name}.torn")
            torn.write_bytes(Path(source).read_bytes()[:100])
            raise Killed
        replace_file(source, target)

    monkeypatch.setattr(identify_archive, "FILES", 2)
    monkeypatch.setattr("difffric.atomic_files.os.replace", die)
    for k in range(20):
        left[0] = k
        try:
            found = identify_fleet(made, out)
        except Killed:
            continue
        break
    assert k >= 3 and found.fresh_files < 9
    assert tree(out) == tree(whole.folder)


@pytest.mark.slow
def test_runs_and_workers_killed_at_random_moments_end_with_the_same_bits(made, tmp_path):
    """The command with two workers; kill -9 of a worker, or of the run."""
    found = kills(made, tmp_path, n=2, times=20, longest=15.0)
    assert found["workers_killed"] and found["runs_killed"] and not found["different"]


def test_a_second_run_does_only_what_is_missing_or_has_changed(archive, tmp_path):
    out = tmp_path / "out"

    def run():
        found = identify_fleet(archive, out)
        assert tree(out) == tree(identify_fleet(archive, tmp_path / "anew").folder)
        shutil.rmtree(tmp_path / "anew")
        return found.fresh_files, found.fresh_parts

    assert run() == (9, 2)
    assert run() == (0, 0)  # the bad one is known to be bad, too
    write(archive / "hall/a/day1/pushes.tdms", RIGS["hall/a"], 99, n=1)
    assert run() == (1, 1)
    stiffer = replace(RIGS["hall/b"], k=1e6)
    files.write_setup(archive / "hall/b/setup.toml", stiffer)
    assert run() == (0, 1)  # its recordings need not be read again
    heavier = replace(stiffer, m=9.02)
    files.write_setup(archive / "hall/b/setup.toml", heavier)
    assert run() == (5, 1)  # here they are held against another mass
    shutil.rmtree(archive / "hall/a")
    assert run() == (0, 0)
    assert set(data_set(out).collect()["rig"]) == {"hall/b"}
    (archive / "hall/b/broken.tdms").write_bytes(b"still none")
    assert run() == (1, 0)
    next(out.glob("pushes/*/*/*.parquet")).write_bytes(b"torn")
    most = max((out / ".fleet").glob("*.parquet"), key=os.path.getsize)
    most.write_bytes(b"torn")
    files_read, parts_made = run()
    assert files_read > 1 and parts_made == 1


def test_what_a_disk_could_not_read_is_tried_again(archive, tmp_path, monkeypatch):
    """A refusal for the file's content is kept, one for the disk's state is not."""
    asked, load = [], features.load

    def fail_once(path, **how):
        asked.append(Path(path).name)
        if len(asked) == 1:
            raise OSError(5, "Input/output error", path)
        return load(path, **how)

    monkeypatch.setattr(features, "load", fail_once)
    first = identify_fleet(archive, tmp_path / "out")
    assert any("Input/output error" in why for _, _, why in first.bad) and len(first.bad) == 2
    second = identify_fleet(archive, tmp_path / "out")
    assert len(asked) == 10 and asked[-1] == asked[0]
    assert second.bad == tuple(x for x in first.bad if "not a TDMS file" in x[2])


def test_a_file_belongs_to_the_nearest_setup_upwards(tmp_path):
    for path in ("x/setup.toml", "x/y/setup.toml", "given.toml"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).touch()
    names = ("x/1.tdms", "x/z/2.CSV", "x/y/3.tdms", "x/.4.tdms", "x/.hidden/5.tdms", "x/out/6.csv")
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = find_files(tmp_path, out=tmp_path / "x/out")
    assert {s.name: s.rig for s in found} == {
        "x/1.tdms": "x",
        "x/z/2.CSV": "x",
        "x/y/3.tdms": "x/y",
    }
    (tmp_path / "w").mkdir()
    (tmp_path / "w/7.tdms").touch()
    with pytest.raises(df.InputError, match=r"w/7\.tdms: no setup\.toml in its folder or above"):
        find_files(tmp_path)
    assert find_files(tmp_path, tmp_path / "given.toml")[0].rig == "w"
    assert [s.name for s in find_files(tmp_path / "x" / "**" / "*.tdms")] == ["1.tdms", "y/3.tdms"]
    assert find_files(tmp_path / "x")[0].rig == "."
    with pytest.raises(df.InputError, match="found none"):
        find_files(tmp_path / "q*.tdms")


def test_a_recording_says_its_date_itself(made, tmp_path):
    """`wf_start_time` counts, not the day on which the file was copied."""
    old, objects = TdmsFile.read(made / "hall/a/day0/pushes.tdms"), []
    for group in old.groups():
        objects.append(group)
        for channel in group.channels():
            channel.properties["wf_start_time"] = np.datetime64("2025-02-03T23:59:00", "us")
            objects.append(channel)
    with TdmsWriter(tmp_path / "1.tdms") as new:
        new.write_segment(objects)
    shutil.copy(made / "hall/a/setup.toml", tmp_path)
    assert set(identify_fleet(tmp_path, tmp_path / "out").pushes.collect()["date"]) == {
        "2025-02-03"
    }


def test_a_rig_whose_setup_is_wrong_is_told_and_the_others_are_identified(archive, tmp_path):
    (archive / "hall/a/setup.toml").write_text("[part]\nmass_kg = -1\n")
    found = identify_fleet(archive, tmp_path / "out")
    assert {rig for rig, _, _ in found.bad} == set(RIGS)
    assert sum("mass_kg" in why for _, _, why in found.bad) == 4
    assert set(found.pushes.collect()["rig"]) == {"hall/b"}


def test_where_no_file_can_be_used_nothing_is_written(tmp_path, made):
    (tmp_path / "a").mkdir()
    shutil.copy(made / "hall/a/setup.toml", tmp_path / "a")
    (tmp_path / "a/1.tdms").write_bytes(b"no recording")
    with pytest.raises(df.InputError, match=r"none of 1 files can be used: 1\.tdms: not a TDMS"):
        identify_fleet(tmp_path / "a", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_several_workers_without_dask_name_the_extra(made, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(df.InputError, match=r"pip install 'difffric\[fleet\]'"):
        identify_fleet(made, tmp_path / "out", n_workers=2)
    assert not (tmp_path / "out").exists()


def test_processes_start_with_the_first_task(monkeypatch):
    asked = []

    @contextmanager
    def connect(n, scheduler):
        asked.append(n)
        yield "client"

    monkeypatch.setattr(workers, "_connect", connect)
    monkeypatch.setattr(workers, "_run_on", lambda client, function, tasks: map(function, tasks))
    with workers.start_workers(2) as run:
        assert list(run(abs, [])) == asked == []
        assert list(run(abs, [-1, -2])) == [1, 2] and list(run(abs, [-3])) == [3]
    assert asked == [2]


def test_a_scheduler_that_does_not_answer_is_told(monkeypatch, made, tmp_path):
    monkeypatch.setattr(workers, "PATIENCE", 1)
    with pytest.raises(df.InputError, match="no scheduler answers"):
        identify_fleet(made, tmp_path / "out", scheduler="tcp://127.0.0.1:9")


def difffric(*arguments):
    call = [sys.executable, "-m", "difffric.commands.main", *map(str, arguments)]
    return subprocess.run(call, cwd=ROOT, capture_output=True, text=True, timeout=300)


def test_the_command_leaves_counts_a_report_and_a_figure(made, tmp_path):
    done = difffric("identify", made, "--out", tmp_path / "out", "--quiet")
    assert done.returncode == 0 and done.stderr == ""
    answer = json.loads((tmp_path / "out/result.json").read_text())
    assert (answer["files"], answer["bad_files"], answer["pushes"]) == (9, 1, 22)
    assert [row["rig"] for row in answer["rigs"]] == sorted(RIGS)
    for row in answer["rigs"]:
        rows = data_set(tmp_path / "out").filter(pl.col("rig") == row["rig"]).collect()
        assert row["mu_s_mean"] == pytest.approx(rows["mu_s"].mean(), rel=1e-12)
        assert row["spread"] == pytest.approx(rows["mu_s"].std() / rows["mu_s"].mean(), rel=1e-9)
    report = (tmp_path / "out/report.html").read_text()
    assert "hall/b/broken.tdms" in report and (tmp_path / "out/mu_s_by_date.png").stat().st_size
    for arguments, words in (
        ([made], "--out is missing"),
        ([made / "hall/a/table.csv"], "--setup is missing"),
        (
            [made, "--workers", "2", "--scheduler", "tcp://h:1", "--out", tmp_path / "o"],
            "one of them",
        ),
    ):
        done = difffric("identify", *arguments)
        assert done.returncode == 2 and words in done.stderr
        assert len(done.stderr.splitlines()) == 1
