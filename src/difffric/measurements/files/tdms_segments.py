"""The segments of a `.tdms` file: what it describes, and where its samples lie.

npTDMS's reader trusts every size and count of the file (a flipped bit moves channels silently, or
asks for terabytes) and takes a segment's whole channel into memory for any slice of it. So the
segments are walked here, each count held against the bytes that are there, and only npTDMS's
types, paths and scalings are used. The format: NI, "TDMS File Format Internal Structure".
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, Any

import numpy as np
from nptdms import types
from nptdms.common import ObjectPath, toc_properties

# What NI's white paper "TDMS File Format Internal Structure" says:
LEAD_IN = 28  # bytes at a segment's start
_NO_DATA, _AS_BEFORE = 0xFFFFFFFF, 0  # in place of an object's index
_UNKNOWN_SIZE = 0xFFFFFFFFFFFFFFFF  # of a segment whose writing never ended
_DAQMX = (0x1269, 0x126A)  # indices of raw data of NI-DAQmx, which are not read
# What a damaged file may claim without taking all memory:
_LARGEST_METADATA = 1 << 28  # bytes
_LARGEST_NAME = 1 << 20  # bytes


class DamagedError(Exception):
    """What of a segment does not hold together, in words."""


class _CutOffError(DamagedError):
    """The file ends within a segment."""


@dataclass(frozen=True)
class Piece:
    """Samples in a segment: `chunks` times `values` in a row, `stride` bytes from one to the
    next, the first at byte `position`."""

    position: int
    values: int
    chunks: int
    stride: int

    @property
    def n(self) -> int:
        """Number of samples."""
        return self.values * self.chunks


@dataclass
class TdmsObject:
    """A group or a channel: its properties, and its samples where it has any."""

    properties: dict[str, Any] = field(default_factory=dict)
    dtype: np.dtype | None = None
    """of the raw samples, with their byte order; None: none, or not numbers"""
    pieces: list[Piece] = field(default_factory=list)
    told: list[dict[str, Any]] = field(default_factory=list)
    """the properties as each segment that names any wrote them"""
    segments: int = 0
    """in how many segments it has samples"""

    @property
    def n(self) -> int:
        """Number of samples."""
        return sum(piece.n for piece in self.pieces)


@dataclass
class Contents:
    """All that a file describes, up to where it is damaged."""

    groups: dict[str, TdmsObject] = field(default_factory=dict)
    channels: dict[tuple[str, str], TdmsObject] = field(default_factory=dict)
    root: dict[str, Any] = field(default_factory=dict)
    damage: str = ""
    """what is wrong and where, else empty"""
    hurt: list[str] = field(default_factory=list)
    """names of the groups that the damage touches"""

    def at(self, path: ObjectPath) -> TdmsObject:
        """The group or channel of a path, made where there is none yet."""
        if path.group is None:
            return TdmsObject(self.root)
        group = self.groups.setdefault(path.group, TdmsObject())
        if path.channel is None:
            return group
        return self.channels.setdefault((path.group, path.channel), TdmsObject())


@dataclass(frozen=True)
class _Index:
    """How an object's samples lie in a segment's chunk."""

    type: Any
    n: int
    size: int
    """bytes"""


@dataclass
class _Described:
    """An object as one segment describes it."""

    path: ObjectPath
    index: _Index | None
    properties: dict[str, Any]


class _Bytes:
    """Metadata of one segment, taken from the front; raises `DamagedError` where it ends."""

    def __init__(self, data: bytes, order: str):
        self.data, self.order, self.at = data, order, 0

    def take(self, n: int) -> bytes:
        if n > len(self.data) - self.at:
            raise DamagedError("its description is longer than the place it has")
        self.at += n
        return self.data[self.at - n : self.at]

    def number(self, kind: str) -> int:
        return struct.unpack(self.order + kind, self.take(struct.calcsize(self.order + kind)))[0]

    def text(self, limit: int | None = None) -> str:
        n = self.number("L")
        if limit is not None and n > limit:
            raise DamagedError(f"a name of {n} bytes")
        return self.take(n).decode("utf-8", errors="replace")

    def index(self, before: _Index | None) -> tuple[_Index | None, bool]:
        """(the layout of the object's samples, whether it has samples in this segment)."""
        header = self.number("L")
        if header == _NO_DATA:
            return before, False
        if header == _AS_BEFORE:
            if before is None:
                raise DamagedError("samples laid out as before, where nothing was before")
            return before, True
        if header in _DAQMX:
            raise DamagedError("raw DAQmx samples, expected plain ones (TDMS Write)")
        kind, dimension, n = self.number("L"), self.number("L"), self.number("Q")
        tds = types.tds_data_types.get(kind)
        size = None if tds is None else tds.size
        if header == 28 and tds is types.String:
            return _Index(tds, n, self.number("Q")), True
        if header != 20 or dimension != 1 or tds is None or not size:
            raise DamagedError(f"samples of an unknown kind ({header}, {kind:#x}, {dimension})")
        return _Index(tds, n, n * size), True

    def properties(self) -> dict[str, Any]:
        return dict(self.property() for _ in range(self.number("L")))

    def property(self) -> tuple[str, Any]:
        name, kind = self.text(_LARGEST_NAME), self.number("L")
        tds = types.tds_data_types.get(kind)
        if tds is types.String:
            return name, self.text()
        if tds is None or not tds.size or not hasattr(tds, "read"):
            raise DamagedError(f"property {name!r} is of an unknown kind ({kind:#x})")
        try:
            return name, tds.read(BytesIO(self.take(tds.size)), self.order)
        except NotImplementedError:
            return name, None


def read_contents(file: IO[bytes], size: int) -> Contents:
    """Walk the segments of an open file of `size` bytes. Only descriptions are read.

    Damage ends the walk and is told in `Contents.damage`; what lies before it is there.
    """
    contents = Contents()
    layouts: dict[str, _Index] = {}
    active: dict[str, _Described] = {}
    position = 0
    while position < size:
        described: list[_Described] = []
        before = _groups(active.values())
        try:
            position, active = _segment(file, size, position, contents, layouts, active, described)
        except DamagedError as damage:
            if isinstance(damage, _CutOffError) and _says_incomplete(contents, before):
                break  # what was written whole is all there
            contents.damage = f"the segment at byte {position}: {damage}"
            # Where it does not even say whose samples it holds, they may be the last group's.
            contents.hurt = _groups(described) or before
            break
    return contents


def _says_incomplete(contents: Contents, last: list[str]) -> bool:
    """Whether the group that was written last is one whose recording never ended: a kill may have
    come in the middle of a segment."""
    return any(contents.groups[name].properties.get("complete") is False for name in last)


def _segment(file, size, position, contents, layouts, active, described):
    """Take in one segment; the next one's position, and the objects that are now active."""
    lead = _read(file, position, min(LEAD_IN, size - position))
    if lead[:4] != b"TDSm"[: len(lead)]:
        raise DamagedError(f"expected it to begin with TDSm, got {lead[:4]!r}")
    if len(lead) < LEAD_IN:
        raise _CutOffError(f"cut off, as the file ends at byte {size}")
    toc = struct.unpack("<L", lead[4:8])[0]
    order = ">" if toc & toc_properties["kTocBigEndian"] else "<"
    version, length, metadata = struct.unpack(order + "LQQ", lead[8:])
    if version not in (4712, 4713):
        raise DamagedError(f"TDMS version {version}, expected 4712 or 4713")
    start = position + LEAD_IN
    end, missing = start + length, ""
    if length == _UNKNOWN_SIZE:
        end, missing = size, "never closed"
    elif end > size:
        end, missing = size, f"cut off: expected {start + length} bytes in all, the file has {size}"
    if metadata > length or (metadata > _LARGEST_METADATA and not missing):
        raise DamagedError(missing or f"a description of {metadata} bytes in {length}")
    if metadata and not toc & toc_properties["kTocMetaData"]:
        raise DamagedError(missing or f"a description of {metadata} bytes, flagged as none")
    if toc & toc_properties["kTocMetaData"]:
        head = _read(file, start, min(metadata, end - start, _LARGEST_METADATA))
        taken = _Bytes(head, order)
        try:
            for one in _objects(taken, layouts):
                described.append(one)
        except DamagedError as damage:
            raise (_CutOffError(missing) if missing else damage) from None
        if not missing and taken.data[taken.at :].strip(b"\0"):
            raise DamagedError("its description ends before the place it has")
        active = {} if toc & toc_properties["kTocNewObjList"] else dict(active)
        names = [str(d.path) for d in described]
        if len(set(names)) < len(names):
            raise DamagedError("it describes an object twice")
        active.update(zip(names, described, strict=True))
    else:
        described += active.values()
    if missing:
        raise _CutOffError(missing)
    samples = list(_pieces(active.values(), toc, start + metadata, end))
    for one in described if toc & toc_properties["kTocMetaData"] else []:
        known = contents.at(one.path)
        known.properties.update(one.properties)
        if one.properties:
            known.told.append(one.properties)
    for one, piece in samples:
        known = contents.at(one.path)
        dtype = _dtype(one.index, order)
        if known.pieces and known.dtype != dtype:
            raise DamagedError(f"samples of {one.path} in a kind that differs from before")
        known.dtype = dtype
        known.pieces.append(piece)
        known.segments += 1
    return end, active


def _groups(described: Iterable[_Described]) -> list[str]:
    return list(dict.fromkeys(d.path.group for d in described if d.path.group is not None))


def _objects(taken: _Bytes, layouts: dict[str, _Index]) -> Iterator[_Described]:
    for _ in range(taken.number("L")):
        name = taken.text(_LARGEST_NAME)
        path = _path(name)
        index, has_data = taken.index(layouts.get(name))
        if has_data and path.channel is None:
            raise DamagedError(f"{name[:40]!r} has samples and is no channel")
        if index is not None:
            layouts[name] = index
        yield _Described(path, index if has_data else None, taken.properties())


@functools.lru_cache(1024)  # a file repeats few of them many times
def _path(name: str) -> ObjectPath:
    try:
        path = ObjectPath.from_string(name)
    except (ValueError, RuntimeError):
        path = None
    if path is None or str(path) != name:
        raise DamagedError(f"{name[:40]!r} is not the path of an object")
    return path


def _pieces(objects, toc: int, start: int, end: int) -> Iterator[tuple[_Described, Piece]]:
    """Where the samples of each object lie between two bytes."""
    laid = [(d, d.index) for d in objects if d.index is not None]
    chunk = sum(index.size for _, index in laid)
    raw = end - start if toc & toc_properties["kTocRawData"] else 0
    if raw != end - start or (raw % chunk if chunk else raw):
        raise DamagedError(f"{end - start} bytes of samples, expected a multiple of {chunk}")
    if not chunk:
        return
    interleaved = bool(toc & toc_properties["kTocInterleavedData"])
    if interleaved and len({index.n for _, index in laid}) > 1:
        raise DamagedError("interleaved samples of channels that differ in length")
    n = laid[0][1].n if interleaved else 1
    at = start
    for one, index in laid:
        if interleaved:
            yield one, Piece(at, 1, raw // (chunk // n), chunk // n)
        elif index.n:
            yield one, Piece(at, index.n, raw // chunk, chunk)
        at += index.size // n


def _dtype(index: _Index | None, order: str) -> np.dtype | None:
    dtype = getattr(index and index.type, "nptype", None)
    return dtype.newbyteorder(order) if dtype is not None and dtype.kind in "iuf" else None


def _read(file: IO[bytes], position: int, n: int) -> bytes:
    file.seek(position)
    data = bytearray()
    while len(data) < n:
        more = file.read(n - len(data))
        if not more:
            raise DamagedError("the file ends before it did when it was opened")
        data += more
    return bytes(data)
