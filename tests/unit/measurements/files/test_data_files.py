"""Measured data in files: what they mean, every way in which they can be wrong, written back."""

from __future__ import annotations

import io
import os
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, GroupObject, RootObject, TdmsFile, TdmsWriter

import difffric as df
from difffric import units
from difffric.errors import InputError
from difffric.measurements.checks import check_data
from difffric.measurements.files.named_columns import parse_plain_cells
from difffric.measurements.files.table_csv import read_table, write_table
from difffric.measurements.files.tdms_reader import read_recordings
from difffric.measurements.files.tdms_writer import RecordingWriter, Waveform, write_recordings
from difffric.measurements.pushes import COLUMNS, Pushes
from difffric.measurements.quantities import OF_RECORDING, QUANTITIES, parse_decimal
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.rig.rig import spring_damper_rig

RIG = spring_damper_rig(mass=18.9, mu_s=0.141, k=8.0e5, b=1500.0)
N = 3000
T = np.arange(N)
PEAK = 180.0 * np.exp(-((T - 600) ** 2) / 5e4)
WAVE = {"wf_increment": 1e-4, "wf_start_offset": -0.02, "wf_samples": N}
PUSH = {"velocity_mm_min": 3000.0, "mass_kg": 18.9, "stroke_mm": 2.0, "condition": "DRY"}


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def table(text) -> Path:
    path = Path("pushes.csv")
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def tdms(*segments) -> Path:
    path = Path("pushes.tdms")
    with TdmsWriter(path) as writer:
        for objects in segments:
            writer.write_segment(list(objects))
    return path


def noisy(seed=0):
    return PEAK + np.random.default_rng(seed).normal(0, 0.5, N)


def force(group="push_01", samples=None, without=(), **says):
    says = {**WAVE, "unit_string": "N"} | says
    says = {key: value for key, value in says.items() if key not in without}
    return ChannelObject(group, "force", noisy() if samples is None else samples, says)


def position(group="push_01", samples=None, **says):
    samples = 0.5 * T if samples is None else samples
    return ChannelObject(group, "position", samples, {**WAVE, "unit_string": "um"} | says)


def group(name="push_01", without=(), **says):
    return GroupObject(name, {k: v for k, v in (PUSH | says).items() if k not in without})


def problems(read, *args, **kwargs) -> list[str]:
    with pytest.raises(InputError) as caught:
        read(*args, **kwargs)
    return str(caught.value).splitlines()


# Names and units


@pytest.mark.parametrize("q", QUANTITIES, ids=lambda q: q.key)
def test_units_agree_with_units_py(q):
    known = {"mm_min": units.MM_PER_MIN, "um": units.UM, "mm": units.MM}
    factor = float(Decimal(q.unit)) / q.per
    assert factor == pytest.approx(known.get(q.unit_name, 1.0), rel=1e-15)
    assert q.attribute in COLUMNS


@given(st.sampled_from([q for q in QUANTITIES if q.range]), st.floats(1e-12, 1e12))
def test_every_value_comes_back_from_its_file_form(q, value):
    assert q.to_si(Decimal(q.from_si(value))) == value


decimals = st.from_regex(r"\A[0-9]{1,17}(\.[0-9]{1,17})?\Z|\A[-+.0-9eE]{0,8}\Z")


@given(st.sampled_from([q for q in QUANTITIES if q.range]), st.lists(decimals, min_size=1))
@settings(deadline=None)  # the first one imports polars
def test_plain_numbers_are_read_together_as_each_is_alone(q, cells):
    together = parse_plain_cells(cells, q)
    for cell, value in zip(cells, together, strict=True):
        short = cell.replace(".", "", 1).isdecimal() and len(cell.replace(".", "", 1)) <= 15
        if not np.isnan(value):
            assert value == q.to_si(parse_decimal(cell))
        else:
            assert not short or cell.startswith(".") or cell.endswith(".")


@given(st.sampled_from([q for q in QUANTITIES if q.range]), st.decimals("1e-6", "1e6", places=4))
def test_every_short_number_of_a_file_comes_back_as_it_was_written(q, number):
    if number > 0:
        assert Decimal(q.from_si(q.to_si(number))) == number


# Tables


def test_a_table_arrives_in_si():
    pushes = read_table(
        table(
            "velocity_mm_min,peak_force_N,sliding_distance_um,mass_kg,stroke_mm,condition,"
            "mu_s_gauge,trial,order,rest_before_s,peak_force_se_N,sliding_distance_se_um,"
            "release_velocity_mm_min,release_velocity_se_mm_min\n"
            '3000,181.2,2840,18.9,2.0,"DRY, new",0.141,1,7,60,0.5,0.3,2900,30\n'
        )
    )
    expected = {
        "velocity": 0.05,
        "peak_force": 181.2,
        "sliding_distance": 2.84e-3,
        "mass": 18.9,
        "stroke": 2e-3,
        "mu_s_gauge": 0.141,
        "trial": 1.0,
        "order": 7.0,
        "rest_before": 60.0,
        "peak_force_se": 0.5,
        "sliding_distance_se": 0.3e-6,
        "release_velocity": 2900e-3 / 60,
        "release_velocity_se": 5e-4,
    }
    assert {name: getattr(pushes, name)[0] for name in expected} == pytest.approx(expected, 1e-15)
    assert pushes.condition == ("DRY, new",)
    assert pushes.source == "pushes.csv" and pushes.skipped == ()


def test_an_empty_cell_was_not_measured():
    pushes = read_table(table("velocity_mm_min,peak_force_N,mass_kg\n500,,18.9\n600, 30 ,\n"))
    assert np.isnan(pushes.peak_force).tolist() == [True, False]
    assert np.isnan(pushes.mass).tolist() == [False, True]


def test_release_speed_and_distance_alone_are_free_slides():
    slides = read_table(table("release_velocity_mm_min,sliding_distance_um\n24000,38000\n"))
    assert slides.free_slides and slides.release_velocity[0] == 0.4


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("head", ["", "\ufeff"])
def test_line_ends_byte_order_marks_and_blank_lines_change_nothing(end, head):
    lines = ["velocity_mm_min,peak_force_N", "500,30", "", "600,40", ",", ""]
    pushes = read_table(table(head + end.join(lines)))
    assert pushes.peak_force.tolist() == [30.0, 40.0]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "empty"),
        ("\n \n", "empty"),
        ("velocity_mm_min,peak_force_N\n", "no rows below the header"),
        ("velocity_mm_min\n500\n", "peak_force_N or sliding_distance_um is missing"),
        ("peak_force_N\n30\n", "velocity_mm_min is missing"),
        ("release_velocity_mm_min,peak_force_N\n5,30\n", "velocity_mm_min is missing"),
        (
            "velocity_mm_min,peak_force_kp_\n500,30\n",
            "peak_force_kp_: unknown, expected peak_force_N",
        ),
        ("velocity_mm_min,force [kx]\n500,30\n", "unit 'kx' is not known, expected N, mN, kN"),
        ("velocity_mm_min,force [mm]\n500,30\n", "in mm, expected peak_force in N, mN, kN"),
        ("velocity,peak_force_N\n500,30\n", "velocity: unknown, expected velocity_mm_min"),
        ("velocity_mm_min,Kraft [N]\n500,30\n", "with --channel peak_force='Kraft [N]'"),
        ("velocity_mm_min,peak_froce_N\n500,30\n", "unknown, expected peak_force_N"),
        ("velocity_mm_min,peak_force_N,mass\n500,30,1\n", "mass: unknown, expected mass_kg"),
        ("velocity_mm_min,peak_force_N,\n500,30,1\n", "column 3 has no name"),
        ("velocity_mm_min,peak_force_N,remark\n500,30,x\n", "remark: unknown, known: velocity"),
        ("velocity_mm_min,peak_force_N,peak_force_N\n5,3,3\n", "peak_force_N stands there 2 times"),
        (
            "velocity_mm_min;peak_force_N\n500;30,5\n600;31.5\n700;32,5\n",
            "line 3, peak_force_N: expected a number > 0, got '31.5' "
            "(a point, where the rest of the file has decimal commas)",
        ),
        ("velocity_mm_min,peak_force_N\n500,30,5\n", "line 2: 3 cells, expected 2: is a comma"),
        ("velocity_mm_min,peak_force_N,mass_kg\n500,3\n", "line 2: 2 cells, expected 3"),
        ('velocity_mm_min,peak_force_N\n500,"1,305"\n', "is its mark one of thousands?"),
        (
            "velocity_mm_min,peak_force_N\n500,30 N\n",
            "numbers only, the unit stands in the heading",
        ),
        ("velocity_mm_min,peak_force_N\n500,nan\n", "line 2, peak_force_N: expected a number > 0"),
        ("velocity_mm_min,peak_force_N\n500,inf\n", "line 2, peak_force_N: expected a number > 0"),
        ("velocity_mm_min,peak_force_N\n500,1e999\n", "expected a finite number > 0"),
        ("velocity_mm_min,peak_force_N\n500,thirty\n", "line 2, peak_force_N: expected a number"),
        (
            "velocity_mm_min,peak_force_N\n-500,30\n",
            "line 2, velocity_mm_min: expected a number > 0",
        ),
        ("velocity_mm_min,peak_force_N\n,30\n", "line 2, velocity_mm_min: empty"),
        (
            "velocity_mm_min,peak_force_N,mass_kg\n5,3,0\n",
            "mass_kg: expected a number > 0, got '0'",
        ),
        ("velocity_mm_min,peak_force_N,stroke_mm\n5,3,-2\n", "stroke_mm: expected a number > 0"),
        ("velocity_mm_min,peak_force_N,peak_force_se_N\n5,3,0\n", "peak_force_se_N: expected"),
        ("velocity_mm_min,peak_force_N,rest_before_s\n5,3,-1\n", "expected a number >= 0"),
        ('velocity_mm_min,peak_force_N\n500,"30\n', "not a table"),
        (b"velocity_mm_min,peak_force_N\n500,30\n\xb5,3\n", "velocity_mm_min: expected a number"),
        (b"PK\x03\x04 xl/workbook.xml", "an Excel workbook (or another archive), not text"),
        (b"\x00\x01\x02\x03\x05\x00", "not text"),
    ],
)
def test_a_table_that_is_wrong_is_refused_by_line_and_column(text, expected):
    lines = problems(df.load, table(text))
    assert expected in "\n".join(lines)
    assert all(line.startswith("pushes.csv: ") for line in lines)


def test_all_that_is_wrong_is_told_at_once_up_to_what_can_be_read():
    rows = "".join(f"500,{x}\n" for x in ["x"] * 14)
    lines = problems(read_table, table("velocity_mm_min,peak_force_N\n" + rows))
    assert lines[0].startswith("pushes.csv: line 2, peak_force_N: ")
    assert lines[9].startswith("pushes.csv: line 11, peak_force_N: ")
    assert lines[10:] == ["and 4 more"]


def test_rows_that_are_wrong_are_skipped_where_asked_and_told():
    path = table("velocity_mm_min,peak_force_N\n500,30\n600,x\n700,50\n800\n")
    pushes = read_table(path, skip_bad=True)
    assert pushes.peak_force.tolist() == [30.0, 50.0]
    assert [line.split(":")[1] for line in pushes.skipped] == [" line 3, peak_force_N", " line 5"]
    lines = problems(read_table, table("velocity_mm_min,peak_force_N\n600,x\n"), skip_bad=True)
    assert "no row of it can be used" in lines[0] and "line 2" in lines[1]


OPTIONAL = st.one_of(st.just(np.nan), st.floats(1e-9, 1e9))
TEXT = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), max_size=8)


@given(st.lists(st.tuples(st.floats(1e-9, 1e3), OPTIONAL, OPTIONAL, TEXT), min_size=1, max_size=6))
def test_a_table_written_reads_as_the_same_pushes_to_the_last_digit(rows):
    v, F, d, condition = zip(*rows, strict=True)
    told = Pushes(
        v, np.append(F[:-1], 30.0), d, mass=d, stroke=F, condition=condition, release_velocity=F
    )
    write_table(told, "pushes.csv")
    again = read_table("pushes.csv")
    for name in COLUMNS:
        x, y = getattr(told, name), getattr(again, name)
        assert x == y if name == "condition" else np.array_equal(x, y, equal_nan=True), name


def test_a_table_that_cannot_be_written_leaves_nothing():
    pushes = Pushes(np.array([0.05]), np.array([30.0]), condition=["two\nlines"])
    assert "condition" in problems(write_table, pushes, "pushes.csv")[0]
    good = replace(pushes, condition=("DRY",))
    assert "cannot be written" in problems(write_table, good, "nowhere/pushes.csv")[0]
    assert os.listdir() == []


# Recordings


def test_a_recording_arrives_in_si():
    path = tdms(
        [
            RootObject({}),
            group(mu_s_gauge=0.141, order=7, rest_before_s=60.0),
            force(),
            position(wf_increment=2e-4, wf_samples=100, samples=np.arange(100.0)),
            ChannelObject(
                "push_01", "pusher", np.arange(9), {**WAVE, "unit_string": "mm"} | {"wf_samples": 9}
            ),
            ChannelObject("push_01", "temperature", np.arange(9)),
        ]
    )
    (push,) = read_recordings(path)
    said = [push.velocity, push.mass, push.stroke, push.mu_s_gauge, push.order, push.rest_before]
    assert said == [0.05, 18.9, 2e-3, 0.141, 7.0, 60.0]
    assert (push.condition, push.name) == ("DRY", "push_01")
    assert push.force is not None and push.position is not None and push.pusher is not None
    assert (push.force.unit, push.position.unit, push.pusher.unit) == ("N", "m", "m")
    assert (push.force.n, push.force.dt, push.force.start) == (N, 1e-4, -0.02)
    assert np.array_equal(push.force.samples, noisy())
    assert np.array_equal(push.position.samples, np.arange(100) / 1e6)
    assert push.position.dt == 2e-4
    assert np.array_equal(push.pusher.samples, np.arange(9) / 1e3)
    assert np.array_equal(push.force.read(100, 250), noisy()[100:250])


def test_a_group_may_say_more_than_is_asked():
    more = {"author": "me", "stroke_type": "ramp", "lost_samples": 3, "mass_before_kg": 1.0}
    (push,) = read_recordings(tdms([group(**more), force()]))
    assert push.mass == 18.9


def test_what_a_group_does_not_say_is_not_known():
    (push,) = read_recordings(tdms([GroupObject("p", {"velocity_mm_min": 500}), force("p")]))
    assert np.isnan([push.mass, push.stroke, push.mu_s_gauge, push.order, push.rest_before]).all()
    assert push.condition == "" and push.position is None


@pytest.mark.parametrize("unit", ["um", "µm", "μm"])
def test_micrometres_are_read_however_they_are_spelt(unit):
    (push,) = read_recordings(tdms([group(), position(unit_string=unit)]))
    assert push.position is not None and push.position.samples[10] == 5e-6


@pytest.mark.parametrize("dtype", ["i1", "i2", "i4", "i8", "u2", "f4", "f8"])
def test_linear_scaling_is_done_in_double_precision_whatever_the_words(dtype):
    words = np.arange(100).astype(dtype)
    scale = {
        "NI_Number_Of_Scales": 1,
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 0.1,
        "NI_Scale[0]_Linear_Y_Intercept": -3.0,
        "NI_Scale[0]_Linear_Input_Source": np.uint32(0xFFFFFFFF),
    }
    (push,) = read_recordings(tdms([group(), force(samples=words, wf_samples=100, **scale)]))
    assert push.force is not None
    assert np.array_equal(push.force.samples, np.arange(100) * 0.1 - 3.0)
    done = scale | {"NI_Scaling_Status": "scaled"}
    (push,) = read_recordings(tdms([group(), force(samples=words, wf_samples=100, **done)]))
    assert push.force is not None and np.array_equal(push.force.samples, np.arange(100))


def raw_segment(layout: list[tuple[str, int]], data: bytes, *, toc: int, order="<", index=True):
    """A segment of float64 channels of push_01, by hand: (name, number of values) of each."""
    import struct

    says = b""
    for name, n in layout:
        path = f"/'push_01'/'{name}'".encode()
        says += struct.pack(order + "L", len(path)) + path
        says += struct.pack(order + "LLLQ", 20, 10, 1, n) if index else struct.pack(order + "L", 0)
        says += struct.pack(order + "L", 0)
    says = struct.pack(order + "L", len(layout)) + says if toc & 2 else b""
    lead = struct.pack(order + "lQQ", 4712, len(says) + len(data), len(says))
    return b"TDSm" + struct.pack("<l", toc) + lead + says + data


NEW, META, RAW, INTERLEAVED, BIG = 4, 2, 8, 32, 64


@pytest.mark.parametrize(
    ("toc", "order"),
    [(0, "<"), (BIG, ">"), (INTERLEAVED, "<"), (INTERLEAVED | BIG, ">")],
    ids=["little", "big", "interleaved", "interleaved big"],
)
def test_layouts_read_as_nptdms_reads_them(toc, order):
    """Several chunks in a segment, layouts repeated, segments without a description."""
    rng = np.random.default_rng(1)
    layout = [("force", 50), ("position", 50)]
    first = tdms([group(), force(samples=[]), position(samples=[])]).read_bytes()
    data = [rng.normal(size=2 * 50 * chunks).astype(f"{order}f8").tobytes() for chunks in (3, 2, 4)]
    path = Path("odd.tdms")
    path.write_bytes(
        first.replace(b"wf_samples", b"wf_smaples")
        + raw_segment(layout, data[0], toc=toc | NEW | META | RAW, order=order)
        + raw_segment(layout, data[1], toc=toc | META | RAW, order=order, index=False)
        + raw_segment(layout, data[2], toc=toc | RAW, order=order)
    )
    (push,), theirs = read_recordings(path), TdmsFile.read(path)["push_01"]
    assert push.force is not None and push.position is not None
    for ours, expected in (
        (push.force, theirs["force"][:]),
        (push.position, theirs["position"][:]),
    ):
        expected = expected / (1e6 if ours.unit == "m" else 1.0)
        assert ours.n == 9 * 50
        assert np.array_equal(ours.samples, expected)
        for lo, hi in [(0, 1), (49, 51), (20, 149), (149, 251), (101, 449), (450, 450)]:
            assert np.array_equal(ours.read(lo, hi), expected[lo:hi])
        assert np.array_equal(np.concatenate(list(ours.chunks(7))), expected)


def test_small_chunks_far_apart_are_read_by_blocks(monkeypatch):
    monkeypatch.setattr("difffric.measurements.files.tdms_samples._BLOCK", 400)
    rng = np.random.default_rng(1)
    data = rng.normal(size=(200, 4)).tobytes()
    layout = [("force", 1), ("position", 3)]
    first = tdms([group(), force(samples=[]), position(samples=[])]).read_bytes()
    path = Path("odd.tdms")
    head = first.replace(b"wf_samples", b"wf_smaples")
    path.write_bytes(head + raw_segment(layout, data, toc=NEW | META | RAW))
    (push,), theirs = read_recordings(path), TdmsFile.read(path)["push_01"]
    assert push.force is not None and push.position is not None
    assert np.array_equal(push.force.samples, theirs["force"][:])
    assert np.array_equal(push.position.read(4, 555), theirs["position"][4:555] / 1e6)


def test_only_what_is_asked_for_is_read(monkeypatch):
    (push,) = read_recordings(tdms([group(), force()]))
    asked = []
    into = "difffric.measurements.files.tdms_samples.OpenFile.into"
    monkeypatch.setattr(
        into, lambda self, buffer, at: asked.append(buffer.nbytes) or not buffer.fill(0)
    )
    assert push.force is not None
    push.force.read(7, 19)
    assert asked == [12 * 8]


def test_an_index_beside_the_file_is_not_trusted():
    good = tdms([group(), force()])
    index = Path("pushes.tdms_index")
    for content in (b"", b"TDSh" + bytes(40), good.read_bytes().replace(b"TDSm", b"TDSh")[:300]):
        index.write_bytes(content)
        (push,) = read_recordings(good)
        assert push.force is not None and np.array_equal(push.force.samples, noisy())
    other = index.rename("other.tdms")
    assert "an index file" in problems(read_recordings, other)[0]


@pytest.mark.parametrize("unit", ["N", "V"])
@pytest.mark.parametrize("what", ["properties repeated", "only data"])
def test_a_push_streamed_in_parts_is_one(unit, what):
    parts = [noisy()[:1000], noisy()[1000:]]
    says = [{}, {"wf_samples": N} if what == "properties repeated" else {}]
    segments = [[group(), force(samples=parts[0], unit_string=unit)]]
    segments.append([ChannelObject("push_01", "force", parts[1], says[1])])
    if what == "properties repeated":
        segments[1].append(group())
    (push,) = read_recordings(tdms(*segments))
    assert push.force is not None and np.array_equal(push.force.samples, noisy())
    # LabVIEW leaves the length of one writing in wf_samples.
    segments[0][1].properties["wf_samples"] = 1000
    if what == "only data":
        (push,) = read_recordings(tdms(*segments[:1], segments[1]))
        assert push.force is not None and push.force.n == N


@pytest.mark.parametrize(
    ("objects", "expected"),
    [
        ([group(without=["velocity_mm_min"]), force()], "velocity_mm_min: missing"),
        (
            [group(without=["velocity_mm_min"], velocity=0.05), force()],
            "property velocity: unknown, expected velocity_mm_min",
        ),
        (
            [group(mass=18.9, without=["mass_kg"]), force()],
            "mass: unknown, expected mass_kg",
        ),
        ([group(velocity_mm_min=-1.0), force()], "velocity_mm_min: expected a number > 0, got -1"),
        ([group(velocity_mm_min="500"), force()], "velocity_mm_min: expected a number > 0, got '5"),
        ([group(mass_kg=float("nan")), force()], "mass_kg: expected a number > 0, got nan"),
        ([group(stroke_mm=float("inf")), force()], "stroke_mm: expected a finite number > 0"),
        ([group()], "expected a channel force or position, got none"),
        (
            [group(), ChannelObject("push_01", "Kraft", noisy(), WAVE)],
            "expected a channel force or position, got Kraft",
        ),
        (
            [group(), force(without=["unit_string"])],
            "channel 'force': unit_string: expected N or V",
        ),
        ([group(), force(unit_string="mm")], "unit_string: expected N or V (mN, kN, MN, lbf"),
        ([group(), position(unit_string="ell")], "expected um, mm or m (cm, nm, in are converted)"),
        ([group(), ChannelObject("push_01", "forse", noisy(), WAVE)], "--channel force='forse'"),
        (
            [group(), force(without=["wf_increment"])],
            "wf_increment: missing, expected the sampling",
        ),
        ([group(), force(wf_increment=0.0)], "wf_increment: expected a number > 0, got 0.0"),
        ([group(), force(wf_increment="1 ms")], "wf_increment: expected a number, got '1 ms'"),
        ([group(), force(wf_samples=N + 1)], f"wf_samples is {N + 1}, found {N} samples"),
        ([group(), force(wf_samples=N - 1)], f"wf_samples is {N - 1}, found {N} samples"),
        ([group(), force(samples=np.empty(0))], "channel 'force': no samples"),
        ([group(), force(samples=["a", "b"])], "its samples are not numbers"),
        (
            [
                group(),
                force(),
                ChannelObject("push_01", "Force", noisy(), {**WAVE, "unit_string": "N"}),
            ],
            "a second channel force",
        ),
        ([group(), force(**{"NI_Scale[0]_Scale_Type": "Cubic"})], "expected one of Linear"),
        ([group(), force(**{"NI_Scale[0]_Scale_Type": "Linear"})], "NI_Scale: cannot be applied"),
        ([group(), force(NI_Number_Of_Scales=2**31 - 1)], "NI_Number_Of_Scales: expected 0 to"),
    ],
)
def test_a_group_that_is_wrong_is_refused_by_name(objects, expected):
    lines = problems(df.load, tdms(objects))
    assert expected in "\n".join(lines)
    assert all(line.startswith("pushes.tdms: group 'push_01'") for line in lines)
    good = [group("good"), force("good")]
    kept = read_recordings(tdms([*objects, *good]), skip_bad=True)
    assert [push.name for push in kept] == ["good"]
    assert kept.skipped and expected in "\n".join(kept.skipped)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_samples_that_are_not_finite_are_refused_when_they_are_read(bad):
    samples = noisy()
    samples[1234] = bad
    data = read_recordings(tdms([group(), force(samples=samples), position()]))
    with pytest.raises(
        InputError, match=r"pushes\.tdms: group 'push_01', channel 'force': .* 1234"
    ):
        _ = data[0].force.samples  # type: ignore[union-attr]
    assert "sample 1234 is" in problems(check_data, data, RIG)[0]


def test_the_same_group_twice_as_after_a_concatenation_is_refused():
    one = tdms([group(), force()]).read_bytes()
    two = tdms([group(velocity_mm_min=500.0), force()]).read_bytes()
    for content in (one + one, one + two):
        Path("both.tdms").write_bytes(content)
        lines = problems(read_recordings, "both.tdms")
        assert "group 'push_01': written 2 times, expected a group of its own" in lines[0]


def test_a_file_cut_off_says_so_and_what_is_whole_is_used_only_where_asked():
    whole = tdms(*[[group(name), force(name)] for name in ("a", "b", "c")]).read_bytes()
    Path("pushes.tdms").write_bytes(whole[:-100])
    lines = problems(read_recordings, "pushes.tdms")
    assert (
        f"cut off: expected {len(whole)} bytes in all, the file has {len(whole) - 100}" in lines[0]
    )
    remedy = "; 2 pushes before it are whole: --skip-bad takes them alone"
    assert lines[0].endswith(remedy)
    assert lines[1] == "pushes.tdms: group 'c': not whole, as the file is damaged"
    kept = read_recordings("pushes.tdms", skip_bad=True)
    assert [push.name for push in kept] == ["a", "b"]
    assert list(kept.skipped) == [lines[0].removesuffix(remedy), *lines[1:]]


def test_a_description_that_the_segment_denies_is_damage():
    """With its flag cleared it would pass for samples of the channels before it."""
    one, two = ([group(name), force(name)] for name in ("a", "b"))
    at, whole = len(tdms(one).read_bytes()), bytearray(tdms(one, two).read_bytes())
    toc = at + 4
    assert whole[at:toc] == b"TDSm" and whole[toc] & 0b10
    whole[toc] ^= 0b10
    Path("pushes.tdms").write_bytes(whole)
    lines = problems(read_recordings, "pushes.tdms")
    assert f"the segment at byte {at}: a description of " in lines[0]
    assert "bytes, flagged as none" in lines[0]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "empty"),
        (b"PK\x03\x04 not at all", "not a TDMS file"),
        (b"TDSm", "cut off"),
        (b"TDSm" + bytes(24), "version 0, expected 4712 or 4713"),
    ],
)
def test_what_is_not_tdms_is_refused(content, expected):
    Path("pushes.tdms").write_bytes(content)
    (line,) = problems(df.load, "pushes.tdms")
    assert line.startswith("pushes.tdms: ") and expected in line


def test_a_file_without_groups_is_refused():
    assert "no groups" in problems(df.load, tdms([RootObject({"author": "me"})]))[0]


# Either kind


@pytest.mark.parametrize("name", ["pushes.csv", "pushes.tdms"])
def test_no_file_and_a_folder_are_refused(name):
    assert problems(df.load, name) == [f"{name}: no such file"]
    Path(name).mkdir()
    assert problems(df.load, name) == [f"{name}: expected a file, got a folder"]


@pytest.mark.parametrize("name", ["pushes.ods", "pushes", "pushes.tdms_index"])
def test_other_kinds_of_file_are_refused(name):
    assert "expected a table (.csv) or recordings (.tdms)" in problems(df.load, name)[0]


def test_the_suffix_may_be_in_capitals():
    assert isinstance(df.load(tdms([group(), force()]).rename("A.TDMS")), Recordings)
    path = table("velocity_mm_min,peak_force_N\n500,30\n").rename("A.CSV")
    assert isinstance(df.load(path), Pushes)


# Writing recordings


def recorded(seed=0, n=N, **says) -> Recording:
    rng = np.random.default_rng(seed)
    return Recording(
        velocity=rng.uniform(0.01, 0.1),
        force=Channel.of(rng.normal(size=n), 5e-6, -0.0123, "N"),
        position=Channel.of(rng.normal(size=n // 2) * 1e-3, 1e-5, -0.0123, "m"),
        **says,
    )


def test_recordings_written_read_as_the_same_to_the_last_bit(monkeypatch):
    monkeypatch.setattr("difffric.measurements.files.tdms_writer._CHUNK", 1000)
    told = Recordings(
        (
            recorded(0, mass=18.9, stroke=1.4654e-3, condition="DRY", mu_s_gauge=0.141),
            recorded(1, order=2.0, rest_before=61.5, name="it's a /name/"),
        )
    )
    Path("pushes.tdms_index").write_bytes(b"stale")
    write_recordings(told, "pushes.tdms")
    assert sorted(os.listdir()) == ["pushes.tdms"]
    again = read_recordings("pushes.tdms")
    assert [push.name for push in again] == ["push_01", "it's a /name/"]
    for a, b in zip(told, again, strict=True):
        for q in OF_RECORDING:
            x, y = getattr(a, q.attribute), getattr(b, q.attribute)
            assert x == y if q.range is None else x == pytest.approx(y, rel=3e-16, nan_ok=True)
        for one, other in ((a.force, b.force), (a.position, b.position)):
            assert one is not None and other is not None
            assert (one.n, one.dt, one.start) == (other.n, other.dt, other.start)
            assert np.array_equal(one.samples, other.samples)
    theirs = TdmsFile.read("pushes.tdms")
    assert theirs["push_01"]["force"].properties["wf_samples"] == N
    assert np.array_equal(theirs["push_01"]["force"][:], told[0].force.samples)  # type: ignore[union-attr]


def test_recordings_that_cannot_be_written_leave_nothing():
    data = Recordings((recorded(name="a"), recorded(name="a")))
    assert problems(write_recordings, data, "x.tdms") == ["x.tdms: group 'a': written already"]
    assert "force in N, expected V" in problems(write_recordings, data, "x.tdms", force_unit="V")[0]

    def failing(lo, hi):
        raise RuntimeError

    broken = Channel(5, 1.0, 0.0, "N", failing)
    with pytest.raises(RuntimeError):
        write_recordings(Recordings((Recording(0.05, broken),)), "x.tdms")
    assert os.listdir() == []


def streamed(path="pushes.tdms"):
    writer = RecordingWriter(path)
    channels = {
        "force": Waveform("V", 5e-6, -0.02, slope=10 / 2**15),
        "position": Waveform("um", 1e-4, -0.02, slope=0.02),
    }
    rng = np.random.default_rng(0)
    words = rng.integers(-(2**15), 2**15, 400).astype(np.int16)
    counts = rng.integers(-(2**40), 2**40, 20)
    for name in ("push_01", "push_02"):
        writer.begin(name, channels, velocity_mm_min=3000.0, order=1, mass_kg=None)
        for i in range(4):
            words_i, counts_i = words[100 * i : 100 * i + 100], counts[5 * i : 5 * i + 5]
            writer.append(force=words_i, position=counts_i)
    return writer, words, counts


def test_words_of_a_card_are_stored_as_they_come_and_read_scaled():
    writer, words, counts = streamed()
    writer.close()
    for push in read_recordings("pushes.tdms"):
        assert push.force is not None and push.position is not None
        assert np.array_equal(push.force.samples, words * (10 / 2**15))
        assert np.array_equal(push.position.samples, counts * 0.02 / 1e6)
        assert (push.force.unit, push.force.dt, push.force.start) == ("V", 5e-6, -0.02)
    assert TdmsFile.read("pushes.tdms")["push_01"]["force"].raw_data.dtype == np.int16
    assert "exists" in problems(RecordingWriter, "pushes.tdms")[0]


def test_what_was_appended_is_readable_without_closing():
    writer, words, _ = streamed()
    data = read_recordings("pushes.tdms")
    assert [push.force.n for push in data] == [400, 400]  # type: ignore[union-attr]
    whole = Path("pushes.tdms").read_bytes()
    Path("cut.tdms").write_bytes(whole[:-7])
    kept = read_recordings("cut.tdms")  # the push says itself that it never ended
    assert [(push.force.n, push.position.n) for push in kept] == [(400, 20), (300, 15)]  # type: ignore[union-attr]
    assert kept[1].force is not None and np.array_equal(
        kept[1].force.samples, words[:300] * (10 / 2**15)
    )
    writer.end()
    Path("cut.tdms").write_bytes(Path("pushes.tdms").read_bytes() + whole[-200:-7])
    with pytest.raises(InputError, match="damaged"):
        read_recordings("cut.tdms")
    writer.begin("push_03", {"force": Waveform("N", 1e-4)}, velocity_mm_min=3000.0)
    writer.append(force=words)
    writer.end(lost=7)
    writer.close()
    whole = Path("pushes.tdms").read_bytes()
    group = TdmsFile.read("pushes.tdms")["push_03"]
    assert group.properties["complete"] and group.properties["lost_samples"] == 7


@pytest.mark.parametrize(
    ("begin", "expected"),
    [
        ({"velocity_mm_min": -1.0}, "velocity_mm_min: expected a number > 0, got -1.0"),
        ({"velocity": 0.05}, "unknown property velocity"),
        ({"channels": {"torque": Waveform("N", 1e-4)}}, "unknown channel torque"),
        ({"channels": {"force": Waveform("m", 1e-4)}}, "force in m"),
    ],
)
def test_what_the_format_cannot_say_is_not_written(begin, expected):
    with RecordingWriter("pushes.tdms") as writer:
        begin = {"channels": {"force": Waveform("N", 1e-4)}} | begin
        with pytest.raises(InputError, match=expected):
            writer.begin("push_01", **begin)
        assert os.path.getsize("pushes.tdms") == 0


# Data held against a rig


def of(*forces, mass=18.9, unit="N") -> Recordings:
    pushes = [
        Recording(0.05, Channel.of(x, 1e-4, -0.02, unit), mass=mass, name=f"push_{i + 1:02d}")
        for i, x in enumerate(forces)
    ]
    return Recordings(tuple(pushes), "pushes.tdms")


@pytest.mark.parametrize("kind", ["table", "recordings"])
def test_a_mass_that_contradicts_the_set_up_is_refused_unless_asked_for(kind):
    masses = np.array([18.9, 19.08, 19.1, np.nan])
    if kind == "table":
        data = Pushes(np.full(4, 0.05), np.full(4, 30.0), mass=masses)
    else:
        pushes = tuple(replace(of(noisy())[0], mass=mass, name="") for mass in masses)
        data = Recordings(pushes)
    (line,) = problems(check_data, data, RIG)
    assert "push 3 of 4: mass 19.1 kg, the set-up's is 18.9 kg" in line
    assert "--use-data-mass" in line
    taken = check_data(data, RIG, use_data_mass=True)
    mine = taken.mass if isinstance(taken, Pushes) else [push.mass for push in taken]
    assert np.array_equal(mine, masses, equal_nan=True)
    kept = check_data(data, RIG, skip_bad=True)
    assert len(kept) == 3 and kept.skipped == (line,)


def test_volts_become_newtons_by_the_sensors_sensitivity():
    (push,) = check_data(of(noisy() * 11.2e-3, unit="V"), RIG)
    assert push.force is not None and push.force.unit == "N"
    assert push.force.samples == pytest.approx(noisy(), rel=1e-15)


def test_data_that_fit_the_rig_are_themselves():
    data = of(noisy())
    assert len(check_data(data, RIG)) == 1
    table = Pushes(np.array([0.05]), np.array([30.0]))
    assert check_data(table, RIG) is table


@pytest.mark.parametrize("chunk", [7, 100, 1 << 20])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("level", [100.0, 150.0, 446.0])
def test_a_saturated_force_is_refused_with_its_level(monkeypatch, chunk, sign, level):
    whole = Channel.chunks
    monkeypatch.setattr(Channel, "chunks", lambda self: whole(self, chunk))
    strong = noisy() * (3.0 if level > 400 else 1.0)
    data = of(noisy(1), sign * np.minimum(strong, level))
    (line,) = problems(check_data, data, RIG)
    assert f"group 'push_02': force saturated at {level:g} N" in line
    assert [push.name for push in check_data(data, RIG, skip_bad=True)] == ["push_01"]
    assert len(check_data(data, RIG, keep_saturated=True)) == 2


@pytest.mark.parametrize(
    "harmless",
    [
        noisy(),
        PEAK,
        np.round(PEAK),  # without noise, coarse: flat stretches everywhere
        np.round(noisy() / 0.5) * 0.5,  # quantised about as coarse as the noise
        np.minimum(PEAK, 0.0),  # no force at all
    ],
    ids=["noisy", "smooth", "coarse and smooth", "coarse and noisy", "zero"],
)
def test_a_force_that_is_not_saturated_is_not_refused(harmless):
    assert len(check_data(of(harmless), RIG)) == 1


def test_quantised_coloured_noise_is_not_taken_for_saturation():
    rng = np.random.default_rng(5)
    for _ in range(200):
        noise = np.zeros(N)
        for i, kick in enumerate(rng.normal(0, 0.22, N)):
            noise[i] = 0.9 * noise[i - 1] + kick
        check_data(of(np.round((PEAK + noise) / 0.22) * 0.22), RIG)


def test_nothing_left_is_refused_even_where_skipping():
    data = of(noisy(), mass=1.0)
    assert "expected within 1 %" in problems(check_data, data, RIG, skip_bad=True)[0]


def test_a_stream_of_bytes_is_not_a_path():
    with pytest.raises(TypeError):
        read_table(io.BytesIO(b""))  # type: ignore[arg-type]
