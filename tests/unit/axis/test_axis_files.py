"""Files of an axis: what they say is read, and what is wrong with them is one clear line."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

import difffric as df
from difffric.axis import format_axis, load_axis, parse_axis
from difffric.axis.recordings import AxisRecordings, AxisStretch, check_recordings
from difffric.errors import InputError
from tests.reference.axis import Axis, record, write_csv

EXAMPLES = Path(__file__).parents[3] / "examples"
SETUP = """\
[axis]                        # a linear axis
mass_kg = 95.0

[friction]
coulomb_N = { value = 20.0, standard_error = 0.1, free = true }
breakaway_N = 24.0
k_v_N_s_per_m = 200.0
scatter = 0.01

[drive]
gain_N_per_V = 35.15
offset_N = -3.0

[probe]
noise_um = 1.0

[effects.cogging]
amplitude_N = 0.3
period_m = 0.012
"""


@pytest.fixture(scope="module")
def made():
    return record(Axis(), speeds=(0.2, 0.3), travel=0.02)


def test_a_set_up_says_what_it_says():
    axis = parse_axis(SETUP)
    assert (axis.mass, axis.breakaway, axis.gain, axis.noise) == (95.0, 24.0, 35.15, 1e-6)
    assert axis.extras["coulomb_N"].standard_error == 0.1
    assert axis.values["cogging.period_m"] == 0.012


def test_a_set_up_comes_back_with_its_comments():
    axis = parse_axis(SETUP)
    text = format_axis(axis)
    assert parse_axis(text) == axis
    assert "# a linear axis" in text
    fitted = format_axis(replace(axis, mass=96.0), "Calibrated on a.csv by difffric fit.")
    assert fitted.startswith("# Calibrated on a.csv by difffric fit.\n")
    assert "mass_kg = 96.0  # fitted\n" in fitted and fitted.count("fitted") == 1


def test_all_that_is_wrong_with_a_set_up_is_named_at_once():
    wrong = "[axis]\nmas_kg = 1\n[friction]\ncoulomb_N = -1\n[part]\nmass_kg = 2\n"
    wrong += "[effects.coging]\namplitude_N = 1\n"
    with pytest.raises(InputError) as found:
        parse_axis(wrong, "s.toml")
    lines = str(found.value).split("\n")
    assert len(lines) == 5
    for words in ("did you mean mass_kg?", "mass_kg: missing", "coulomb_N: expected a number > 0",
                  "[part]: an axis has none", "did you mean cogging?"):  # fmt: skip
        assert any(words in line for line in lines)


@pytest.mark.parametrize("european", [False, True])
def test_a_text_is_read_whatever_its_separator_and_decimal_mark(tmp_path, made, european):
    path = tmp_path / "a.csv"
    write_csv(path, made, volts_per_newton=0.1, european=european)
    data = load_axis(path)
    assert (data.unit, len(data), data.samples) == ("V", 2, len(made.t))
    force = np.concatenate([x.force for x in data.stretches])
    position = np.concatenate([x.position for x in data.stretches])
    assert np.allclose(force, 0.1 * made.force, rtol=1e-6, atol=1e-6)
    assert np.allclose(position, made.measured, rtol=0, atol=1e-10)
    assert type(df.load(path)) is AxisRecordings


def test_a_tdms_has_a_group_for_each_stretch(tmp_path, made):
    path = tmp_path / "a.tdms"
    with TdmsWriter(path) as file:
        for k in (0, 1):
            own = made.stretch == k
            says = {"wf_increment": 1e-3, "wf_start_offset": float(made.t[own][0])}
            file.write_segment([
                RootObject(), GroupObject(f"s{k}"),
                ChannelObject(f"s{k}", "force", made.force[own], says | {"unit_string": "N"}),
                ChannelObject(
                    f"s{k}", "position", 1e6 * made.measured[own], says | {"unit_string": "um"}
                ),
            ])  # fmt: skip
    said = {"force": "force", "position": "position"}
    for data in (load_axis(path), df.load(path), load_axis(path, channels=said)):
        assert [x.name for x in data.stretches] == ["s0", "s1"]
        assert np.allclose(data.stretches[1].position, made.measured[made.stretch == 1])
        assert np.allclose(data.stretches[1].time, made.t[made.stretch == 1])


def test_names_that_are_said_are_read(tmp_path, made):
    path = tmp_path / "a.csv"
    write_csv(path, made)
    plain = load_axis(path)
    heading, rest = path.read_text().split("\n", 1)
    assert heading == "time_s,force_N,position_mm,stretch"
    path.write_text("Zeit,Kraft [N],Weg (mm),stretch\n" + rest)
    said = {"time_s": "Zeit", "force": "Kraft", "position": "Weg"}
    for data in (load_axis(path, channels=said), df.load(path, channels=said)):
        for one, expected in zip(data.stretches, plain.stretches, strict=True):
            assert np.array_equal(one.position, expected.position)
            assert np.array_equal(one.force, expected.force)
    with pytest.raises(InputError, match="--channel position='Weg "):
        load_axis(path, channels={"time_s": "Zeit"})


def test_columns_that_are_none_of_ours_are_passed_over(tmp_path, made):
    """An index without a name, as pandas writes it; a set-point, named almost as a position."""
    path = tmp_path / "a.csv"
    write_csv(path, made)
    rows = path.read_text().splitlines()
    more = [f"{i - 1 if i else ''},{row},{0 if i else 'position_set_mm'}"
            for i, row in enumerate(rows)]  # fmt: skip
    plain = load_axis(path)
    path.write_text("\n".join(more))
    for one, expected in zip(load_axis(path).stretches, plain.stretches, strict=True):
        assert np.array_equal(one.position, expected.position)


def test_a_set_up_says_what_files_call_their_columns():
    axis = parse_axis(SETUP + "\n[files]\nforce = 'Kraft'\n")
    assert axis.channels == {"force": "Kraft"}
    assert parse_axis(format_axis(axis)).channels == axis.channels
    with pytest.raises(InputError, match=r"\[files\] force: expected a name in quotes, got 3"):
        parse_axis(SETUP + "\n[files]\nforce = 3\n")


def test_a_matlab_file_is_refused_with_the_line_that_converts_it(tmp_path):
    path = tmp_path / "EMPS.mat"
    path.write_bytes(b"MATLAB 5.0 MAT-file")
    with pytest.raises(InputError, match=r"writetable\(T, 'EMPS.csv'\)"):
        load_axis(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,force_N\n0,1\n", "position_mm is missing"),
        ("time_s,position_mm\n0,1\n", "force_N or drive_V is missing"),
        ("time_s,force_N,position_mm\n0,,1\n", "line 2: empty where a number is needed"),
        ("time_s,force_N,position_mm\n", "no rows"),
    ],
)
def test_what_a_text_lacks_is_named(tmp_path, text, words):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        load_axis(path)


def write_tdms(path, channels):
    with TdmsWriter(path) as file:
        file.write_segment([
            RootObject(), GroupObject("1"),
            *(ChannelObject("1", name, samples, says) for name, samples, says in channels),
        ])  # fmt: skip


def test_a_tdms_may_have_other_names_and_units_and_a_channel_of_times(tmp_path, made):
    path = tmp_path / "a.tdms"
    write_tdms(path, [
        ("Zeit", 1e3 * made.t, {"unit_string": "ms"}),
        ("Kraft", 1e-3 * made.force, {"unit_string": "kN"}),
        ("Weg", 1e3 * made.measured, {"unit_string": "mm"}),
    ])  # fmt: skip
    data = load_axis(path, channels={"time": "Zeit", "force": "Kraft", "position": "Weg"})
    (one,) = data.stretches
    assert np.allclose(one.time, made.t)
    assert np.allclose(one.force, made.force)
    assert np.allclose(one.position, made.measured)
    assert "channel Kraft: converted from kN" in data.notes
    with pytest.raises(InputError, match="--channel force=Kraft --channel position=Weg"):
        load_axis(path)


@pytest.mark.parametrize(
    ("says", "words"),
    [
        ({"unit_string": "mm"}, "wf_increment: missing"),
        ({"unit_string": "mm", "wf_increment": -1.0}, "wf_increment: expected a number > 0"),
        ({"unit_string": "N", "wf_increment": 1e-3}, "expected um, mm or m, got 'N'"),
        ({"wf_increment": 1e-3}, "expected um, mm or m, got none"),
    ],
)
def test_what_a_tdms_lacks_is_named(tmp_path, made, says, words):
    path = tmp_path / "a.tdms"
    write_tdms(path, [
        ("force", made.force, {"unit_string": "N", "wf_increment": 1e-3}),
        ("position", made.measured, says),
    ])  # fmt: skip
    with pytest.raises(InputError, match=words) as found:
        load_axis(path)
    assert "\n" not in str(found.value)


def stretch(t, force, x):
    return AxisRecordings([AxisStretch("1", np.asarray(t), np.asarray(force), np.asarray(x))])


T = np.arange(4000) * 1e-3
WAVE = 10 * np.sin(T)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (stretch(T[::-1], WAVE, WAVE), "time_s does not grow"),
        (stretch(T, WAVE, 0 * T), "the position never changes"),
        (stretch(T, 0 * T, WAVE), "motion without a force"),
        (stretch(T[:9], WAVE[:9], WAVE[:9]), "expected a stretch of"),
        (stretch(T, WAVE * np.nan, WAVE), "expected finite numbers"),
    ],
)
def test_what_cannot_be_fitted_is_refused(data, words):
    with pytest.raises(InputError, match=words):
        check_recordings(data)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (stretch(np.where(T > 2, T + 1, T), WAVE, WAVE), "1 gap in time"),
        (stretch(T, np.clip(WAVE, -5, 5), WAVE), "a saturated drive?"),
        (stretch(T, WAVE, (0.9 * T) % 1.0), "an encoder that wraps?"),
    ],
)
def test_what_is_odd_is_told(data, words):
    assert any(words in note for note in check_recordings(data).notes)


def test_a_drive_in_volts_needs_its_gain(made):
    data = AxisRecordings([AxisStretch("1", made.t, made.force, made.measured)], unit="V")
    with pytest.raises(InputError, match="gain_N_per_V"):
        df.fit(parse_axis("[axis]\nmass_kg = 1\n[friction]\ncoulomb_N = 1\n"), data)


def test_an_axis_and_a_push_are_not_mixed_up(made, tmp_path):
    path = tmp_path / "recording.csv"
    write_csv(path, made)
    pushes = df.load(EXAMPLES / "pushes.csv")
    rig = df.load_setup(EXAMPLES / "setup.toml")
    with pytest.raises(InputError, match=r"expected a set-up with \[axis\]"):
        df.fit(rig, df.load(path))
    with pytest.raises(InputError, match="expected a recording of an axis"):
        df.fit(parse_axis(SETUP), pushes)
    with pytest.raises(InputError, match="a table of pushes") as found:
        load_axis(EXAMPLES / "pushes.csv")
    assert "\n" not in str(found.value)
