"""The samples of one channel of a `.tdms` file, read where they are asked for."""

from __future__ import annotations

import re
import threading
import weakref
from bisect import bisect_right
from collections.abc import Mapping
from fractions import Fraction
from itertools import accumulate
from typing import IO, Any

import numpy as np
from nptdms.base_segment import RawChannelDataChunk
from nptdms.scaling import LinearScaling, MultiScaling, get_scaling
from numpy.typing import NDArray

from difffric.errors import InputError
from difffric.measurements.files.tdms_segments import TdmsObject
from difffric.units import Unit

_AT_ONCE = 1 << 15  # samples
_BLOCK = 1 << 22  # bytes that are read to pick a channel out of several
_MOST = 1000  # scales or coefficients
_SCALES = (
    *("Linear", "Polynomial", "Table", "Add", "Subtract", "AdvancedAPI"),
    *("RTD", "Strain", "Thermistor", "Thermocouple"),
)


class OpenFile:
    """A file that several channels read from, perhaps in several threads; closed after the last."""

    def __init__(self, file: IO[bytes]):
        self._file: Any = file
        self._lock = threading.Lock()
        weakref.finalize(self, file.close)

    def into(self, buffer: NDArray, position: int) -> bool:
        """Fill an array with what stands from byte `position` on; False where there is less."""
        view, done = memoryview(buffer.view(np.uint8)), 0  # type: ignore[arg-type]
        with self._lock:
            self._file.seek(position)
            while done < len(view):
                n = self._file.readinto(view[done:])
                if not n:
                    return False
                done += n
        return True


class Samples:
    """`read(lo, hi)` of a channel: its samples, scaled as the file says, in SI by their `unit`.

    Raises `InputError`, which begins with `where`, for a sample that is not finite and where the
    file has become shorter.
    """

    def __init__(
        self,
        file: OpenFile,
        where: str,
        channel: TdmsObject,
        scaling: MultiScaling | None,
        unit: Unit | None = None,
    ):
        assert channel.dtype is not None
        self._file, self._where, self._dtype = file, where, channel.dtype
        self._scaling = scaling
        # 1 µm is a millionth, which is no float: a million is, and so the quotient is the exacter.
        factor = Fraction(1) if unit is None else Fraction(unit.factor) / unit.per
        over = factor.numerator == 1
        self._factor = 1.0 if over else float(factor)
        self._divisor = float(factor.denominator) if over else 1.0
        scales = [] if scaling is None else scaling.scalings
        # The usual one, without the intermediate arrays of the general way.
        self._linear = scales[0] if [type(x) for x in scales] == [LinearScaling] else None
        self._pieces = channel.pieces
        self._ends = list(accumulate(piece.n for piece in channel.pieces))

    def read(self, lo: int, hi: int) -> NDArray:
        """Samples lo <= i < hi, as floats."""
        lo, hi = max(lo, 0), min(hi, self._ends[-1])
        samples = np.empty(max(hi - lo, 0))
        with np.errstate(all="ignore"):  # what is not finite is told
            for at in range(lo, hi, _AT_ONCE):
                self._block(samples[at - lo : min(at + _AT_ONCE, hi) - lo], at)
        return samples

    def _block(self, out: NDArray, lo: int) -> None:
        """Samples from `lo` on: few enough to stay in the processor's cache."""
        plain = self._scaling is None and self._dtype == out.dtype
        raw = out if plain else np.empty(len(out), self._dtype)
        at, hi, i = lo, lo + len(out), bisect_right(self._ends, lo)
        while at < hi:
            end = min(hi, self._ends[i])
            first = at - (self._ends[i] - self._pieces[i].n)
            self._fill(raw[at - lo : end - lo], self._pieces[i], first)
            at, i = end, i + 1
        if self._linear is not None:
            np.multiply(raw, self._linear.slope, out=out, dtype=float)
            out += self._linear.intercept
        elif self._scaling is not None:
            channel = RawChannelDataChunk.channel_data(raw.astype(float))
            out[:] = self._scaling.scale(channel)
        elif not plain:
            out[:] = raw
        if self._divisor != 1.0:
            out /= self._divisor
        elif self._factor != 1.0:
            out *= self._factor
        if not np.isfinite(out.sum()):
            self._refuse_not_finite(out, lo)

    def _fill(self, out: NDArray, piece, first: int) -> None:
        """Raw samples of one piece from its sample `first` on."""
        size = self._dtype.itemsize
        if piece.chunks == 1 or piece.stride == piece.values * size:
            self._bytes(out, piece.position + first * size)
            return
        done = 0
        while done < len(out):
            chunk, skip = divmod(first + done, piece.values)
            position = piece.position + chunk * piece.stride
            if skip or piece.values * size >= _BLOCK // 64:  # worth a reading of its own
                n = min(piece.values - skip, len(out) - done)
                self._bytes(out[done : done + n], position + skip * size)
            else:
                chunks = min(-(-(len(out) - done) // piece.values), max(_BLOCK // piece.stride, 1))
                used = piece.values * size
                block = np.empty((chunks - 1) * piece.stride + used, np.uint8)
                self._bytes(block, position)
                rows = np.lib.stride_tricks.as_strided(block, (chunks, used), (piece.stride, 1))
                values = np.ascontiguousarray(rows).reshape(-1).view(self._dtype)
                n = min(len(values), len(out) - done)
                out[done : done + n] = values[:n]
            done += n

    def _bytes(self, out: NDArray, position: int) -> None:
        if not self._file.into(out, position):
            raise InputError(f"{self._where}: the file is shorter than it was when it was opened")

    def _refuse_not_finite(self, samples: NDArray, lo: int) -> None:
        bad = ~np.isfinite(samples)
        if bad.any():
            i = int(np.argmax(bad))
            raise InputError(
                f"{self._where}: sample {lo + i} is {samples[i]}, expected a finite number "
                f"({int(bad.sum())} of {len(bad)} samples from {lo} on are not)"
            )


def read_scaling(channel: Mapping, group: Mapping, root: Mapping) -> MultiScaling | None:
    """The scaling that the properties of a channel, its group and its file say, tried once.

    Raises `ValueError` where it makes no sense.
    """
    for properties in (channel, group, root):
        for name, value in properties.items():
            _check_scale(name, value)
    try:
        scaling = get_scaling(channel, group, root)
        if scaling is not None:
            with np.errstate(all="ignore"):
                tried = scaling.scale(RawChannelDataChunk.channel_data(np.array([0.0, 1.0])))
            if np.shape(tried) != (2,) or np.asarray(tried).dtype.kind not in "iuf":
                raise ValueError("it gives no numbers")
    # npTDMS raises whatever its arithmetic meets: a missing key, a text for a number, a scale
    # that is its own input.
    except Exception as error:
        raise ValueError(f"NI_Scale: cannot be applied: {type(error).__name__}: {error}") from None
    return scaling


def _check_scale(name: str, value) -> None:
    """npTDMS makes as many scales and coefficients as a property says, and passes over kinds it
    does not know, which would leave volts for newtons."""
    counts = name == "NI_Number_Of_Scales" or re.fullmatch(r"NI_Scale\[.*_Size", name)
    if counts and not (isinstance(value, int) and 0 <= value <= _MOST):
        raise ValueError(f"{name}: expected 0 to {_MOST}, got {value!r}")
    found = re.fullmatch(r"NI_Scale\[(\d+)\]_Scale_Type", name)
    if found and (len(found[1]) > 3 or value not in _SCALES):
        raise ValueError(f"{name}: expected one of {', '.join(_SCALES)}, got {value!r}")
