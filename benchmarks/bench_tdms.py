"""Reading recordings: every sample of a `.tdms` of 100 MB, as float64 in memory or by chunks."""

from __future__ import annotations

import numpy as np
import pytest
from nptdms import ChannelObject, GroupObject, TdmsFile, TdmsWriter

from benchmarks import contest
from difffric.measurements.load_file import load

GROUP = "9. Reading every sample of a .tdms of 100 MB: 16 pushes, force and position"
PUSHES, N = 16, 400_000
CHUNK = 1 << 16
REFERENCE = "difffric, whole channels"
KINDS = {
    "doubles": ({}, {}),
    "scaled words": (
        {"NI_Number_Of_Scales": 1, "NI_Scale[0]_Scale_Type": "Linear"},
        {
            "NI_Scale[0]_Linear_Slope": 0.0136,
            "NI_Scale[0]_Linear_Y_Intercept": 0.0,
            "NI_Scale[0]_Linear_Input_Source": np.uint32(0xFFFFFFFF),
        },
    ),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Files of about 100 MB: doubles as LabVIEW scales them, or a card's words."""
    folder = tmp_path_factory.mktemp("tdms")
    rng = np.random.default_rng(0)
    for kind, (scaling, numbers) in KINDS.items():
        with TdmsWriter(folder / f"{kind}.tdms") as writer:
            n = N if kind == "doubles" else 2 * N
            wave = {"wf_increment": 5e-6, "wf_start_offset": -0.02, "wf_samples": n}
            for i in range(PUSHES):
                force = rng.normal(0, 100, n)
                position = np.cumsum(rng.integers(0, 3, n))
                if kind == "doubles":
                    says, position = wave, 0.02 * position
                else:
                    says = {**wave, **scaling, **numbers}
                    force, position = force.astype(np.int16), position.astype(np.int32)
                name = f"push_{i + 1:02d}"
                writer.write_segment(
                    GroupObject(name, {"velocity_mm_min": 3000.0}),
                    ChannelObject(name, "force", force, {**says, "unit_string": "N"}),
                    ChannelObject(name, "position", position, {**says, "unit_string": "um"}),
                )
    return folder


def _some(samples, unit=1.0):
    """A few samples, in SI, of a channel that was read whole."""
    return [float(samples[i]) * unit for i in (0, len(samples) // 2, -1)]


def _ours(path):
    def call():
        channels = [x for push in load(path) for x in (push.force, push.position)]
        return np.array([_some(x.samples) for x in channels]).T

    return call


def _ours_in_chunks(path):
    def call():
        for push in load(path):
            for x in (push.force, push.position):
                for _ in x.chunks(CHUNK):
                    pass

    return call


def _nptdms(path):
    def call():
        channels = [c for g in TdmsFile.read(path).groups() for c in g.channels()]
        return np.array([_some(c[:], _unit(c)) for c in channels]).T

    return call


def _nptdms_opened(path):
    def call():
        with TdmsFile.open(path) as file:
            channels = [c for g in file.groups() for c in g.channels()]
            return np.array([_some(c.read_data(), _unit(c)) for c in channels]).T

    return call


def _unit(channel):
    return 1e-6 if channel.properties["unit_string"] == "um" else 1.0


def _nptdms_in_chunks(path):
    def call():
        with TdmsFile.open(path) as file:
            for c in (c for g in file.groups() for c in g.channels()):
                for lo in range(0, len(c), CHUNK):
                    c.read_data(lo, CHUNK)

    return call


# contender -> what makes its call, whether it has an answer to compare
CONTENDERS = {
    REFERENCE: (_ours, True),
    "difffric, in chunks of 65 536 samples": (_ours_in_chunks, False),
    "npTDMS, TdmsFile.read": (_nptdms, True),
    "npTDMS, TdmsFile.open, whole channels": (_nptdms_opened, True),
    "npTDMS, TdmsFile.open, in chunks of 65 536 samples": (_nptdms_in_chunks, False),
}


@pytest.mark.benchmark(group=GROUP)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("contender", CONTENDERS)
def test_read_everything(benchmark, files, contender, kind):
    make, answers = CONTENDERS[contender]
    path = files / f"{kind}.tdms"
    slow = make is _nptdms_in_chunks
    contest.race(
        benchmark,
        f"{contender}, {kind}",
        make(path),
        names=("samples",) if answers else (),
        reference=_nptdms(path) if answers else None,
        within=1e-15,
        rounds=2 if slow else 7,
        is_reference=contender == REFERENCE and kind == "doubles",
    )
