"""Recordings written, `.tdms`: whole, or streamed while they are recorded."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter
from numpy.typing import ArrayLike

from difffric.atomic_files import write_whole
from difffric.errors import DiskError, InputError
from difffric.measurements.files.tdms_reader import CHANNELS
from difffric.measurements.quantities import OF_RECORDING, join_problems
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.units import find_unit

_CHUNK = 1 << 20  # samples
_RAW = np.uint32(0xFFFFFFFF)  # npTDMS's and LabVIEW's name for unscaled samples as an input


@dataclass(frozen=True)
class Waveform:
    """How the samples of a channel are to be read.

    With a `slope` they are stored as they come (the words of a card) and worth
    `slope * sample + intercept` in `unit`.
    """

    unit: str
    """`N` or `V`; `um`, `mm` or `m`"""
    dt: float
    """sampling interval [s]"""
    start: float = 0.0
    """time of the first sample [s], relative to the start of the pusher's motion"""
    slope: float | None = None
    intercept: float = 0.0

    def properties(self) -> dict[str, Any]:
        """As LabVIEW writes them."""
        says = {
            "unit_string": self.unit,
            "wf_increment": float(self.dt),
            "wf_start_offset": float(self.start),
        }
        if self.slope is not None:
            says |= {
                "NI_Scaling_Status": "unscaled",
                "NI_Number_Of_Scales": np.uint32(1),
                "NI_Scale[0]_Scale_Type": "Linear",
                "NI_Scale[0]_Linear_Slope": float(self.slope),
                "NI_Scale[0]_Linear_Y_Intercept": float(self.intercept),
                "NI_Scale[0]_Linear_Input_Source": _RAW,
            }
        return says


class RecordingWriter:
    """A `.tdms` file that grows while pushes are recorded, with its `.tdms_index`.

        with RecordingWriter("pushes.tdms") as writer:
            writer.begin("push_01", {"force": Waveform("N", 5e-6, slope=0.0137)},
                         velocity_mm_min=3000.0)
            writer.append(force=words)
            writer.end()

    Each `append` is a segment, handed to the system before the next, with the number of samples
    so far: what was appended is readable wherever the program ends. A push whose `complete` is
    false was cut there. The index hears of a segment when the file has it, so that it can lack
    the last one and never has one too many.

    Raises `InputError` where the file exists (unless `replace`) or cannot be made, and for what
    the format cannot say; `DiskError` where the disk takes no more. What it took of that segment
    is taken back.
    """

    def __init__(self, path: str | os.PathLike, *, replace: bool = False):
        self._path = path
        try:
            self._file = _Growing(path, replace)
        except FileExistsError:
            raise InputError(f"{path}: exists, and recordings are not overwritten") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from None
        try:
            self._index = _Growing(f"{path}_index", replace=True)
        except OSError as error:
            self._file.close()
            Path(path).unlink()  # empty, and in the way of the next try
            raise InputError(f"{path}_index: cannot be written: {error.strerror}") from None
        self._segments = _Segments(self._file.piece, path, self._index.piece)

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def begin(self, name: str, channels: Mapping[str, Waveform], **properties: Any) -> None:
        """Begin a push: its channels (`force`, `position`, `pusher`), and its properties as the
        file names them (`velocity_mm_min`, `mass_kg`, ...); None: not known."""
        self._segments.begin(name, channels, properties, {"complete": False})
        self._hand_over()

    def append(self, **samples: ArrayLike) -> None:
        """More samples of channels of the push that was begun last; of one or of several."""
        self._segments.append(samples)
        self._hand_over()

    def end(self, lost: int = 0) -> None:
        """The push that was begun last is complete, but for `lost` samples after its last."""
        self._segments.say({"complete": True, "lost_samples": lost})
        self._hand_over()

    def close(self) -> None:
        """Close the file; a second time does nothing."""
        for file in (self._file, self._index):
            file.close()

    def discard(self) -> None:
        """Close the file and remove it."""
        self.close()
        Path(self._path).unlink()
        _forget_index(self._path)

    def _hand_over(self) -> None:
        try:
            self._file.hand_over()
            self._index.hand_over()
        except OSError as error:
            raise DiskError(f"{self._path}: cannot be written: {error.strerror}") from None


class _Growing:
    """A file that takes pieces, each whole or not at all."""

    def __init__(self, path: str | os.PathLike, replace: bool):
        self._file = open(path, "wb" if replace else "xb", buffering=0)  # noqa: SIM115
        self.piece = io.BytesIO()
        """what goes into it next"""
        self._size = 0

    def hand_over(self) -> None:
        """The piece into the file. Raises `OSError`, with the file as it was."""
        with self.piece.getbuffer() as piece:
            done = 0
            try:
                while done < len(piece):  # a full disk takes a part, and then raises
                    done += self._file.write(piece[done:])
            except OSError:
                with suppress(OSError):
                    self._file.truncate(self._size)
                raise
            self._size += done
        self.piece.seek(0)
        self.piece.truncate()

    def close(self) -> None:
        self._file.close()


def write_recordings(
    recordings: Recordings, path: str | os.PathLike, *, force_unit: str = "N"
) -> None:
    """Write recordings as LabVIEW would, a group a push, by chunks.

    Lengths are written in m and forces as they are, so that reading gives the same samples to the
    last bit. The file appears whole or not at all. Raises `InputError` for a force that is not in
    `force_unit` (`N` or `V`), for names given twice, and where the path cannot be written.
    """
    wrong = [
        f"{path}: group {push.name!r}: force in {push.force.unit}, expected {force_unit}"
        for push in recordings
        if push.force is not None and push.force.unit != force_unit
    ]
    if wrong:
        raise InputError(join_problems(wrong))

    def write(file):
        segments = _Segments(file, path)
        digits = len(str(len(recordings)))
        for i, push in enumerate(recordings):
            channels = {key: getattr(push, key) for key in CHANNELS}
            channels = {key: one for key, one in channels.items() if one is not None}
            segments.begin(
                push.name or f"push_{i + 1:0{max(digits, 2)}}",
                {key: Waveform(one.unit, one.dt, one.start) for key, one in channels.items()},
                _properties(push),
            )
            for key, one in channels.items():
                _copy(one, key, segments)

    write_whole(path, write)
    _forget_index(path)


def _copy(channel: Channel, key: str, segments: _Segments) -> None:
    for samples in channel.chunks(_CHUNK):
        segments.append({key: np.asarray(samples, float)})


def _properties(push: Recording) -> dict[str, Any]:
    """What a recording says, as its file's group has it."""
    said: dict[str, Any] = {}
    for q in OF_RECORDING:
        value = getattr(push, q.attribute)
        if q.range is None:
            said[q.key] = value or None
        else:
            said[q.key] = None if np.isnan(value) else float(q.from_si(float(value)))
    return said


class _Segments:
    """Pushes as segments of an open file."""

    def __init__(self, file: IO[bytes], path, index: IO[bytes] | None = None):
        beside: Any = index or False
        self._writer, self._path = TdmsWriter(file, index_file=beside), path
        self._names: set[str] = set()
        self._name = ""
        self._channels: dict[str, Waveform] = {}
        self._n: dict[str, int] = {}

    def begin(
        self,
        name: str,
        channels: Mapping[str, Waveform],
        properties: Mapping,
        marks: Mapping | None = None,
    ) -> None:
        where, known = f"{self._path}: group {name!r}", {q.key: q for q in OF_RECORDING}
        problems = [f"{where}: written already"] if name in self._names else []
        problems += [f"{where}: unknown property {key}" for key in properties.keys() - known.keys()]
        for key, waveform in channels.items():
            if key not in CHANNELS:
                problems.append(f"{where}: unknown channel {key}, known: {', '.join(CHANNELS)}")
            elif (unit := find_unit(waveform.unit)) is None or unit.of not in CHANNELS[key]:
                problems.append(f"{where}: {key} in {waveform.unit}")
        for key, value in properties.items():
            q = known.get(key)
            if q is None or q.range is None or value is None:
                continue
            if not (np.isfinite(value) and q.range.holds(value)):
                problems.append(
                    f"{where}: {key}: {q.range.describe_expected(value)}, got {value!r}"
                )
        if problems:
            raise InputError(join_problems(problems))
        said = {key: value for key, value in properties.items() if value is not None}
        said |= marks or {}
        root = [] if self._names else [RootObject({"description": "push recordings"})]
        self._writer.write_segment([*root, GroupObject(name, said)])
        self._names.add(name)
        self._name, self._channels, self._n = name, dict(channels), dict.fromkeys(channels, 0)

    def say(self, marks: Mapping) -> None:
        """More properties of the push that was begun last."""
        self._writer.write_segment([GroupObject(self._name, dict(marks))])

    def append(self, samples: Mapping[str, ArrayLike]) -> None:
        objects = []
        for key, given in samples.items():
            if key not in self._channels:
                raise InputError(f"{self._path}: group {self._name!r} has no channel {key}")
            words = np.ascontiguousarray(given)
            if words.ndim != 1 or words.dtype.kind not in "iuf":
                raise InputError(f"{self._path}: {key}: expected numbers in a row")
            if not len(words):
                continue
            says = {} if self._n[key] else self._channels[key].properties()
            self._n[key] += len(words)
            # Each segment says how many there are up to its end: true wherever the file is cut.
            says["wf_samples"] = self._n[key]
            objects.append(ChannelObject(self._name, key, words, says))
        if objects:
            self._writer.write_segment(objects)


def _forget_index(path) -> None:
    """A `.tdms_index` of the file that was there before would mislead who trusts it."""
    Path(f"{path}_index").unlink(missing_ok=True)
