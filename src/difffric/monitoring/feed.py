"""Measured pushes on their way to a monitor: from files in order, or from one that is being
written; each once, whatever was counted before."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from difffric.atomic_files import opened
from difffric.errors import InputError
from difffric.measurements.checks import checked_data
from difffric.measurements.files.tdms_reader import read_recordings
from difffric.measurements.files.tdms_segments import read_contents
from difffric.measurements.load_file import load
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.monitoring.monitor import Monitor
from difffric.monitoring.records import Seen, content_of, content_of_recording
from difffric.monitoring.state_file import load as load_state
from difffric.monitoring.state_file import save
from difffric.progress import Tell, silent
from difffric.rig.setup import Setup

_SAVED = 0.5  # [s] of pushes from a file that a kill may take, to be counted again
_LOOK = 0.2  # [s] between looks at a file that grows
_STILL = 2.0  # [s] without growth after which a group that does not say so is complete


@dataclass
class Source:
    """A file whose pushes were counted."""

    name: str
    label: str
    """its name, or one like it where another file has that too"""
    first: str
    """the content of its first push"""
    count: int = 0
    chain: str = ""
    """of all contents counted"""

    def add(self, content: str) -> None:
        self.chain, self.count = linked(self.chain, content), self.count + 1


@dataclass(frozen=True)
class Item:
    """A push of a file."""

    content: str
    order: float
    name: str
    take: Callable[[Monitor, str], Seen]
    """gives it to a monitor, as of a source"""


def linked(chain: str, content: str) -> str:
    """The chain with a content more."""
    return hashlib.sha256(f"{chain}\0{content}".encode()).hexdigest()[:32]


class Feed:
    """A monitor, the files it has counted, and the state file that both are kept in."""

    def __init__(
        self,
        setup: Setup,
        *,
        arl: float | None = None,
        state: Path | None = None,
        on_push: Callable[[Seen], None] = lambda seen: None,
    ):
        self.state, self.on_push, self.skipped = state, on_push, list[str]()
        self.sources: list[Source] = []
        if state is not None and state.exists():
            self.monitor, sources = load_state(state, setup)
            self.sources = [Source(**x) for x in sources]
            if arl is not None and arl != self.monitor.arl:
                raise InputError(f"--arl: {state} was begun with {self.monitor.arl:g}, got {arl:g}")
        else:
            self.monitor = Monitor(setup, arl=1000.0 if arl is None else arl)
        self.before = self.monitor.count
        self.seen_again = 0

    def files(
        self,
        paths: Sequence[Path],
        *,
        use_data_mass: bool = False,
        skip_bad: bool = False,
        tell: Tell = silent,
    ) -> None:
        """Take all pushes of the files, in this order, that were not counted before.

        Raises `InputError` for files that cannot be used, for an `order` that goes back, and for
        a push that is there twice; nothing of any file is counted then.
        """
        planned: list[tuple[Source, Item]] = []
        contents: set[str] = set()
        for path in paths:
            tell(f"reading {path.name}", 0.0)
            data = load(path, skip_bad=skip_bad)
            rig = self.monitor.setup.rig
            options = {"use_data_mass": use_data_mass, "skip_bad": skip_bad}
            if isinstance(data, Recordings):
                data = checked_data(data, rig, **options)
            else:
                data = checked_data(data, rig, **options)
            self.skipped += data.skipped
            items = items_of(data)
            source, new = self._unseen(path, items)
            in_order(path, items)
            for item in new:
                if item.content in contents:
                    raise InputError(f"{path}: {item.name}: the same push twice{_ORDER}")
                self.monitor.check("", f"{path}: {item.name}", item.content, np.nan)
                contents.add(item.content)
            planned += [(source, item) for item in new]
        saved = time.monotonic()
        for i, (source, item) in enumerate(planned):
            tell(f"push {i + 1} of {len(planned)}", i / len(planned))
            self._take(source, item)
            if time.monotonic() - saved > _SAVED:
                self.save()
                saved = time.monotonic()
        self.save()

    def follow(
        self,
        path: Path,
        *,
        idle: float | None = None,
        tell: Tell = silent,
    ) -> None:
        """Take the pushes of a .tdms as they are written, until none came for `idle` [s], or for
        ever; the state is saved after each."""
        source, done, heard = None, 0, time.monotonic()
        grown = Growth(path)
        while True:
            tell(f"waiting for push {self.monitor.count + 1}", 0.0)
            recordings = grown.complete()
            if source is None and recordings:
                items = items_of(Recordings(tuple(recordings), str(path)))
                source, new = self._unseen(path, items)
                done = len(items) - len(new)
            for recording in recordings[done:]:
                assert source is not None
                item = items_of(Recordings((recording,), str(path)))[0]
                self._take(source, item)
                self.save()
                done, heard = done + 1, time.monotonic()
            if idle is not None and time.monotonic() - heard > idle:
                return
            time.sleep(_LOOK)

    def save(self) -> None:
        """Write the state file, where there is one."""
        if self.state is not None:
            save(self.state, self.monitor, [asdict(x) for x in self.sources])

    def _take(self, source: Source, item: Item) -> None:
        seen = item.take(self.monitor, source.label)
        source.add(item.content)
        if source not in self.sources:
            self.sources.append(source)
        self.on_push(seen)

    def _unseen(self, path: Path, items: list[Item]) -> tuple[Source, list[Item]]:
        """(the source that a file is, its items that are not counted yet)."""
        alike = [x for x in self.sources if x.name == path.name]
        known = [x for x in alike if x.first == items[0].content]
        if not known:
            label = path.name if not alike else f"{path.name} ({len(alike) + 1})"
            return Source(path.name, label, items[0].content), items
        source, chain = known[0], ""
        for item in items[: source.count]:
            chain = linked(chain, item.content)
        if len(items) < source.count or chain != source.chain:
            raise InputError(
                f"{path}: its first {source.count} pushes are not those that were counted: "
                "expected the file as it was, with pushes added at its end"
            )
        self.seen_again += source.count
        return source, items[source.count :]


_ORDER = " (two pushes that read alike need an order each)"


def in_order(path: Path, items: Sequence[Item]) -> None:
    """Raises `InputError` where the order of a file's pushes goes back."""
    last = -np.inf
    for item in items:
        if item.order <= last:
            raise InputError(
                f"{path}: {item.name}: its order is {item.order:g} after {last:g}: expected it "
                "to grow"
            )
        last = last if np.isnan(item.order) else item.order


def items_of(data: Pushes | Recordings) -> list[Item]:
    """The pushes of a file, one by one. Raises `InputError` for free slides."""
    if isinstance(data, Recordings):
        return [_recorded(r) for r in data]
    if data.free_slides:
        raise InputError(f"{data.source}: expected pushes, got free slides")
    return [_row(data.select([i]), i) for i in range(len(data))]


def _recorded(recording) -> Item:
    content = content_of_recording(recording)

    def take(monitor: Monitor, source: str) -> Seen:
        return monitor.record(recording, source=source, content=content)

    return Item(content, recording.order, f"group {recording.name!r}", take)


def _row(push: Pushes, i: int) -> Item:
    content = content_of(push)
    columns = ("velocity", "peak_force", "sliding_distance", "peak_force_se",
               "sliding_distance_se", "mass", "stroke", "order")  # fmt: skip
    said: dict[str, Any] = {name: float(getattr(push, name)[0]) for name in columns}

    def take(monitor: Monitor, source: str) -> Seen:
        return monitor.update(
            **said, condition=push.condition[0], name=f"push {i + 1}", source=source,
            content=content,
        )  # fmt: skip

    return Item(content, said["order"], f"push {i + 1}", take)


class Growth:
    """A .tdms that is being written: which of its groups are complete."""

    def __init__(self, path: Path):
        if path.suffix.lower() != ".tdms":
            raise InputError(f"{path}: --follow: expected a .tdms that is being written")
        self.path, self.size, self.since = path, -1, time.monotonic()
        self._found: list = []
        self._asked = (-1, False)

    def complete(self) -> list:
        """The recordings that nothing will be added to, in their order."""
        try:
            size = os.path.getsize(self.path)
        except FileNotFoundError:
            return []
        if size != self.size:
            self.size, self.since = size, time.monotonic()
        still = time.monotonic() - self.since > _STILL
        if size == 0 or self._asked == (size, still):
            return self._found
        self._asked = size, still
        with opened(self.path) as file:
            groups = read_contents(file, size).groups
        last = next(reversed(groups), None)
        told = {name: group.properties.get("complete") for name, group in groups.items()}
        done = {
            name for name, said in told.items()
            if said is True or (said is None and (name != last or still))
        }  # fmt: skip
        try:
            found = read_recordings(self.path, skip_bad=True)
        except InputError:  # nothing whole is in it yet
            return []
        self._found = [r for r in found if r.name in done]
        return self._found
