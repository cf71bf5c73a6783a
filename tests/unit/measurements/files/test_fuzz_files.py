"""The three readers against damaged files: an answer that is whole and finite, or `InputError`."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, GroupObject, TdmsWriter

from difffric.errors import InputError
from difffric.measurements.files.table_csv import read_table
from difffric.measurements.files.tdms_reader import CHANNELS, read_recordings
from difffric.measurements.quantities import QUANTITIES
from difffric.rig.setup_toml import read_setup
from tests.unit.rig.test_setup_toml import FULL

SHARED = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
N = 40


def recordings() -> bytes:
    """Three pushes as LabVIEW would write them: doubles, scaled words, and samples in parts."""
    wave = {"wf_increment": 1e-4, "wf_start_offset": -1e-3, "wf_samples": N}
    scaled = {
        "NI_Number_Of_Scales": 1,
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 0.0137,
        "NI_Scale[0]_Linear_Y_Intercept": 0.0,
        "NI_Scale[0]_Linear_Input_Source": np.uint32(0xFFFFFFFF),
    }
    file = io.BytesIO()
    t = np.arange(N)
    with TdmsWriter(file) as writer:
        for name, raw, says in [("push_1", False, {}), ("push_2", True, scaled)]:
            force = (100 * np.sin(t)).astype(np.int16) if raw else 100 * np.sin(t)
            writer.write_segment(
                GroupObject(name, {"velocity_mm_min": 3000.0, "mass_kg": 18.9, "condition": "DRY"}),
                ChannelObject(name, "force", force, {**wave, **says, "unit_string": "N"}),
                ChannelObject(name, "position", 0.1 * t, {**wave, "unit_string": "µm"}),
            )
        writer.write_segment(GroupObject("push_3", {"velocity_mm_min": 500.0}))
        for lo in (0, N // 2):
            says = {**wave, "unit_string": "V"} if lo == 0 else None
            part = ChannelObject("push_3", "force", np.cos(t[lo : lo + N // 2]), says)
            writer.write_segment(part)
        return file.getvalue()


WHOLE = recordings()


def answers(read, path, skip_bad=None):
    """What a reader gives, or None for an `InputError` that names the file in each line."""
    try:
        return read(path) if skip_bad is None else read(path, skip_bad=skip_bad)
    except InputError as error:
        lines = str(error).splitlines()
        assert lines
        for line in lines:
            assert str(path) in line or line.startswith("and "), line
        return None


def looks_whole(path, skip_bad=False, lengths=None) -> int:
    """Read all of a `.tdms`; how many pushes it has. `lengths`: those a channel may have."""
    data = answers(read_recordings, path, skip_bad)
    if data is None:
        return 0
    for push in data:
        assert push.velocity > 0 and np.isfinite(push.velocity)
        assert push.force is not None or push.position is not None
        for channel in (getattr(push, key) for key in CHANNELS):
            if channel is None:
                continue
            assert channel.dt > 0 and np.isfinite(channel.time[[0, -1]]).all()
            # A damaged description may say fewer samples, never more than there are bytes.
            assert 0 < channel.n <= len(WHOLE)
            assert lengths is None or channel.n in lengths
            with contextlib.suppress(InputError):
                samples = channel.samples
                assert samples.shape == (channel.n,)
                assert np.isfinite(samples).all()
    return len(data)


@pytest.fixture
def tdms(tmp_path):
    path = tmp_path / "pushes.tdms"

    def make(data: bytes):
        path.write_bytes(data)
        return path

    return make


def test_what_is_not_damaged_is_whole(tdms):
    path = tdms(WHOLE)
    assert looks_whole(path) == 3
    assert [push.force.n for push in read_recordings(path)] == [N, N, N]


@pytest.mark.parametrize("parts", range(50))
def test_a_truncated_recording_is_refused_or_was_cut_between_segments(tdms, parts):
    size = len(WHOLE) * parts // 50
    path = tdms(WHOLE[:size])
    boundary = size == 0 or size in segment_starts(WHOLE)
    if not boundary:
        with pytest.raises(InputError, match=r"pushes\.tdms"):
            read_recordings(path)
    kept = looks_whole(path, skip_bad=True)
    complete = sum(end <= size for end in [*segment_starts(WHOLE), len(WHOLE)][1:3])
    assert kept >= max(complete - 1, 0)  # the last may be the one that is cut
    if kept:
        for push, whole in zip(read_recordings(path, skip_bad=True), original(tdms), strict=False):
            assert push.name == whole.name and push.force.n == whole.force.n


def original(tdms):
    path = tdms(WHOLE).rename(tdms(WHOLE).with_name("whole.tdms"))
    return read_recordings(path)


def segment_starts(data: bytes) -> list[int]:
    starts, at = [], data.find(b"TDSm")
    while at >= 0:
        starts.append(at)
        at = data.find(b"TDSm", at + 1)
    return starts


@pytest.mark.parametrize("bit", range(8))
def test_a_flipped_bit_in_the_head_gives_whole_channels_or_is_refused(tdms, bit):
    for at in range(600):
        data = bytearray(WHOLE)
        data[at] ^= 1 << bit
        # Twice as long where a group's name has become that of another.
        looks_whole(tdms(bytes(data)), lengths=(N, 2 * N))
        if at % 7 == bit:
            looks_whole(tdms(bytes(data)), skip_bad=True)


@pytest.mark.parametrize("seed", range(4))
def test_bytes_changed_anywhere_give_whole_channels_or_are_refused(tdms, seed):
    rng = np.random.default_rng(seed)
    for _ in range(250):
        data = np.frombuffer(WHOLE, np.uint8).copy()
        where = rng.integers(0, len(data), rng.integers(1, 6))
        data[where] = rng.integers(0, 256, len(where))
        looks_whole(tdms(data.tobytes()), skip_bad=bool(rng.integers(2)))


@SHARED
@given(
    at=st.integers(0, len(WHOLE)),
    gone=st.integers(0, 200),
    new=st.one_of(st.binary(max_size=60), st.sampled_from([b"\xff" * 8, b"\0" * 28, b"TDSm"])),
)
def test_pieces_replaced_give_whole_channels_or_are_refused(tdms, at, gone, new):
    looks_whole(tdms(WHOLE[:at] + new + WHOLE[at + gone :]))


@SHARED
@given(st.binary(max_size=300), st.booleans())
def test_garbage_is_refused(tdms, data, tagged):
    path = tdms(b"TDSm" * tagged + data)
    assert answers(read_recordings, path) is None


CELLS = st.one_of(
    st.sampled_from(["", "500", "1e3", " 7 ", "-1", "0", "0,5", "nan", "inf", "1e999", "1_0", "٣"]),
    st.sampled_from(["1e-400", "9" * 400, "\ufeff", "#", "1e9999999999999", '"a\nb"', "DRY", '"']),
    st.floats().map(repr),
    st.text(max_size=6),
)
ROWS = st.lists(st.lists(CELLS, max_size=5).map(",".join), max_size=5)
HEADS = st.lists(st.one_of(st.sampled_from([q.key for q in QUANTITIES]), CELLS), max_size=5)


@SHARED
@given(HEADS.map(",".join), ROWS, st.sampled_from(["\n", "\r\n", "\r"]), st.booleans())
@example("velocity_mm_min,peak_force_N", ["500,", "500,1e-310"], "\n", False)
@example("velocity_mm_min,peak_force_N,condition", ['500,1,"a'], "\n", True)
@example("velocity_mm_min,peak_force_N", ["1e-320,1", "4e-324,1"], "\n", False)
def test_a_table_is_finite_and_positive_or_refused(tmp_path, head, rows, end, skip_bad):
    path = tmp_path / "pushes.csv"
    path.write_bytes(end.join([head, *rows]).encode("utf-8", errors="replace"))
    pushes = answers(read_table, path, skip_bad)
    if pushes is None:
        return
    assert 0 < len(pushes) <= len(rows) + sum(row.count("\n") + row.count("\r") for row in rows)
    for q in QUANTITIES:
        if q.range is not None:
            column = getattr(pushes, q.attribute)
            assert (np.isnan(column) | (np.isfinite(column) & q.range.holds(column))).all()


@SHARED
@given(st.binary(max_size=200))
def test_any_bytes_as_a_table_or_a_set_up_are_answered_or_refused(tmp_path, data):
    for name, read in (("pushes.csv", read_table), ("setup.toml", read_setup)):
        path = tmp_path / name
        path.write_bytes(data)
        answers(read, path)


VALUES = ["1e999", "-0.0", "nan", "inf", "true", '"x"', "[1]", "{}", "1e-400", "0x1F", "10" * 300]
VALUES += [
    "{ value = 1, lower = 2 }",
    "1979-05-27",
    "1_000",
    "{ value = { value = 1 } }",
    "'",
    "1e99999",
]


@SHARED
@given(
    line=st.integers(0, FULL.count("\n")),
    new=st.one_of(st.text(max_size=20), st.sampled_from(VALUES)),
    keep_key=st.booleans(),
)
def test_a_set_up_with_a_line_changed_is_answered_or_refused(tmp_path, line, new, keep_key):
    lines = FULL.splitlines()
    old = lines[line] if line < len(lines) else ""
    lines[line : line + 1] = [f"{old.split('=')[0]}= {new}" if keep_key and "=" in old else new]
    path = tmp_path / "setup.toml"
    path.write_bytes("\n".join(lines).encode("utf-8", errors="replace"))
    setup = answers(read_setup, path)
    assert setup is None or setup.rig.mass > 0
