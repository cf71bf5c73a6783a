"""The feed of a monitor: measured pushes from files in order, or from one that is being written.
Each push is counted once, whatever was counted before."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from difffric.atomic_files import open_file
from difffric.errors import InputError
from difffric.known_so_far import tell_known
from difffric.measurements.checks import check_data
from difffric.measurements.files.tdms_reader import read_recordings
from difffric.measurements.files.tdms_segments import read_contents
from difffric.measurements.load_file import load
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recording, Recordings
from difffric.monitoring.monitor import Monitor
from difffric.monitoring.records import NUMBERS, PushRecord, digest_push, digest_recording
from difffric.monitoring.state_file import load as load_state
from difffric.monitoring.state_file import save
from difffric.progress import Tell, silent
from difffric.rig.setup import Setup

_SAVED = 0.5  # [s] between saves: a kill takes what came since, and it is counted again
_LOOK = 0.2  # [s] between looks at a file that grows
_STILL = 2.0  # [s] without growth after which a group that does not say so is complete


@dataclass
class CountedFile:
    """A file whose pushes were counted."""

    name: str
    label: str
    """its name, or a name like it where another file has that too"""
    first: str
    """digest of its first push"""
    count: int = 0
    """pushes counted"""
    chain: str = ""
    """digest of the digests of all pushes counted, in their order"""

    def add(self, content: str) -> None:
        """Count a push of this digest."""
        self.chain, self.count = chain_digest(self.chain, content), self.count + 1


@dataclass(frozen=True)
class Item:
    """A push of a file."""

    content: str
    """its digest"""
    order: float
    name: str
    take: Callable[[Monitor, str], PushRecord]
    """gives the push to a monitor, as of a source of this label"""


def chain_digest(chain: str, content: str) -> str:
    """Return the chain of digests with one digest more."""
    return hashlib.sha256(f"{chain}\0{content}".encode()).hexdigest()[:32]


class Feed:
    """A monitor, the files it has counted, and the state file that both are kept in.

    `arl` is the monitor's, 1000 by default; a state that was begun goes on with its own. `on_push`
    is called after each push. Raises `InputError` for a state that cannot be gone on from.
    """

    def __init__(
        self,
        setup: Setup,
        *,
        arl: float | None = None,
        state: Path | None = None,
        on_push: Callable[[PushRecord], None] = lambda seen: None,
    ):
        self.state, self.on_push, self.skipped = state, on_push, list[str]()
        self.channels = setup.channels
        self.notes: list[str] = []
        self.sources: list[CountedFile] = []
        if state is not None and state.exists():
            self.monitor, sources = load_state(state, setup)
            self.sources = [CountedFile(**x) for x in sources]
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
        planned: list[tuple[CountedFile, Item]] = []
        contents: set[str] = set()
        for path in paths:
            tell(f"reading {path.name}", 0.0)
            loaded: Any = load(
                path, skip_bad=skip_bad, channels=self.channels
            )  # of one kind, and stays so
            self.notes += loaded.notes
            rig = self.monitor.setup.rig
            options = {"use_data_mass": use_data_mass, "skip_bad": skip_bad}
            data: Pushes | Recordings = check_data(loaded, rig, **options)
            self.skipped += data.skipped
            items = list_items(data)
            source, new = self._find_unseen(path, items)
            check_order(path, items)
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
            found = f"{self.monitor.count} pushes, {len(self.monitor.alarms)} alarms"
            tell_known("what was watched", found)
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
        ever. The state is saved after each push."""
        source, done, heard = None, 0, time.monotonic()
        grown = Growth(path)
        while True:
            tell(f"waiting for push {self.monitor.count + 1}", 0.0)
            recordings = grown.complete()
            if source is None and recordings:
                items = list_items(Recordings(tuple(recordings), str(path)))
                source, new = self._find_unseen(path, items)
                done = len(items) - len(new)
            for recording in recordings[done:]:
                assert source is not None
                item = list_items(Recordings((recording,), str(path)))[0]
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

    def _take(self, source: CountedFile, item: Item) -> None:
        seen = item.take(self.monitor, source.label)
        source.add(item.content)
        if source not in self.sources:
            self.sources.append(source)
        self.on_push(seen)

    def _find_unseen(self, path: Path, items: list[Item]) -> tuple[CountedFile, list[Item]]:
        """Return the source that a file is, and its pushes that are not counted yet.

        Raises `InputError` where the file's first pushes are not those that were counted.
        """
        alike = [x for x in self.sources if x.name == path.name]
        known = [x for x in alike if x.first == items[0].content]
        if not known:
            label = path.name if not alike else f"{path.name} ({len(alike) + 1})"
            return CountedFile(path.name, label, items[0].content), items
        source, chain = known[0], ""
        for item in items[: source.count]:
            chain = chain_digest(chain, item.content)
        if len(items) < source.count or chain != source.chain:
            raise InputError(
                f"{path}: its first {source.count} pushes are not those that were counted: "
                "expected the file as it was, with pushes added at its end"
            )
        self.seen_again += source.count
        return source, items[source.count :]


_ORDER = " (two pushes that read alike need an order each)"


def check_order(path: Path, items: Sequence[Item]) -> None:
    """Raise `InputError` where the order of a file's pushes goes back."""
    last = -np.inf
    for item in items:
        if item.order <= last:
            raise InputError(
                f"{path}: {item.name}: its order is {item.order:g} after {last:g}: expected it "
                "to grow"
            )
        last = last if np.isnan(item.order) else item.order


def list_items(data: Pushes | Recordings) -> list[Item]:
    """List the pushes of a file one by one. Raises `InputError` for free slides."""
    if isinstance(data, Recordings):
        return [_make_recording_item(r) for r in data]
    if data.free_slides:
        raise InputError(f"{data.source}: expected pushes, got free slides")
    return [_make_row_item(data.select([i]), i) for i in range(len(data))]


def _make_recording_item(recording: Recording) -> Item:
    """Make the item of a recorded push."""
    content = digest_recording(recording)

    def take(monitor: Monitor, source: str) -> PushRecord:
        return monitor.record(recording, source=source, content=content)

    return Item(content, recording.order, f"group {recording.name!r}", take)


def _make_row_item(push: Pushes, i: int) -> Item:
    """Make the item of row i of a table; `push` has that row alone."""
    content = digest_push(push)
    said: dict[str, Any] = {name: float(getattr(push, name)[0]) for name in NUMBERS}

    def take(monitor: Monitor, source: str) -> PushRecord:
        return monitor.update(
            **said,
            condition=push.condition[0],
            name=f"push {i + 1}",
            source=source,
            content=content,
        )

    return Item(content, said["order"], f"push {i + 1}", take)


class Growth:
    """A .tdms that is being written: which of its groups are complete."""

    def __init__(self, path: Path):
        if path.suffix.lower() != ".tdms":
            raise InputError(f"{path}: --follow: expected a .tdms that is being written")
        self.path, self.size, self.since = path, -1, time.monotonic()
        self._found: list[Recording] = []
        self._asked = (-1, False)

    def complete(self) -> list[Recording]:
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
        with open_file(self.path) as file:
            groups = read_contents(file, size).groups
        last = next(reversed(groups), None)
        complete = {name: group.properties.get("complete") for name, group in groups.items()}
        done = {
            name
            for name, said in complete.items()
            if said is True or (said is None and (name != last or still))
        }
        try:
            found = read_recordings(self.path, skip_bad=True)
        except InputError:  # nothing whole is in it yet
            return []
        self._found = [r for r in found if r.name in done]
        return self._found
