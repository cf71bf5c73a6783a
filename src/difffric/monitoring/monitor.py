"""The monitor: it follows a machine push by push, its friction and the evidence of a change."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from difffric.errors import DifffricError, InputError
from difffric.measurements.checks import check_data
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recording, Recordings
from difffric.measurements.reduction.reduce import reduce_recordings
from difffric.monitoring import shiryaev_roberts
from difffric.monitoring.alarms import Alarm, date_change, make_after, make_alarm, remove_pushes
from difffric.monitoring.baseline import Baseline, Spread
from difffric.monitoring.local_level import WANDER, Level
from difffric.monitoring.readings import Reader
from difffric.monitoring.records import Cell, PushRecord, digest_push, digest_recording
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup, check_rig, refuse_recorded_motion

SCATTER = 0.015
"""Relative scatter of mu_s where the set-up says none: a scale only, as the spread is learnt."""
PRIOR = 3.0
"""Pushes that the set-up's scatter and noise count for, beside those that come."""
KEPT = 500
"""Pushes that are remembered one by one, for the charts and for the change after an alarm."""
WATCHED = 20
"""Pushes after an alarm that still help to say what it was."""
LEAST_ARL = 20.0
"""Least average run length [pushes]: a false alarm more often than that is of no use."""
_SAME_SPEED, _SAME_MASS = 0.025, 0.01  # relative differences that do not make another cell or part
_REMEMBERED = 2000  # digests of pushes, so that none is counted twice


class Monitor:
    """Follows the friction of a machine over its pushes, in their order, and raises alarms.

    `update` takes one push, from a table, a stream or the loop of `acquire`, and returns what it
    makes of it. Each push gives its mu_s and a contrast that mu_s cannot explain (`readings`). Both
    are held against the mean of the pushes before of the same part (its condition and mass), speed
    and stroke (`baseline`), so that neither a new part nor a new speed is an alarm even where the
    model is a little wrong; the first push of each is the first of a mean. The evidence over all of
    them (`shiryaev_roberts`) reaches its threshold once in `arl` pushes, in the mean, while nothing
    changes. After an alarm (`alarms`) the means begin anew from the estimated change on.

    `as_dict` has all that it knows, as JSON can hold it, and `Monitor.read` goes on from there as
    if nothing had been between, to the last bit.

    Raises `InputError` for an `arl` below 20, and for values of the rig out of range.
    """

    def __init__(self, setup: Setup | Rig, *, arl: float = 1000.0):
        setup = setup if isinstance(setup, Setup) else Setup(setup)
        check_rig(setup.rig)
        refuse_recorded_motion(setup, "monitor: follows pushes at constant speed")
        if not (math.isfinite(arl) and arl >= LEAST_ARL):
            raise InputError(f"--arl: expected at least {LEAST_ARL:g} pushes, got {arl:g}")
        self.setup, self.arl = setup, float(arl)
        self.reader = Reader(setup.rig)
        self.scatter = max(setup.mu_s_scatter or SCATTER, 1e-3)
        self.log_threshold = shiryaev_roberts.log_threshold(arl)
        known = setup.mu_s_scatter is not None
        self.count = 0
        self.cells: dict[str, Cell] = {}
        self.parts: dict[str, list[Any]] = {}
        self.friction = Baseline(Spread.from_prior(1.0, PRIOR if known else 0.0))
        self.contrast = Baseline(
            Spread.from_prior(1.0, PRIOR if all(self.reader.noise_known) else 0.0)
        )
        self.levels: dict[str, Level] = {}
        self.log_R = shiryaev_roberts.start()
        self.begun = 1
        """number of the first push that counts towards the next alarm"""
        self.kept: list[PushRecord] = []
        self.alarms: list[Alarm] = []
        self.orders: dict[str, float] = {}
        self.contents: list[str] = []
        self.identified = 0
        self.judged = 0

    def update(
        self,
        velocity: float,
        peak_force: float = math.nan,
        sliding_distance: float = math.nan,
        *,
        peak_force_se: float = math.nan,
        sliding_distance_se: float = math.nan,
        mass: float = math.nan,
        stroke: float = math.nan,
        condition: str = "",
        order: float = math.nan,
        name: str = "",
        source: str = "",
        content: str | None = None,
        reason: str | None = None,
    ) -> PushRecord:
        """Take one push, SI units; NaN: not measured or not said.

        `order` must grow within a `source`. `content` identifies the push, by default all that is
        said of it. A push with a `reason` is counted and not looked at.

        Raises `InputError` for a push that was counted before, an order that goes back, and
        numbers out of range; the monitor is then as it was.
        """
        push = Pushes(
            velocity=_column(velocity),
            peak_force=_column(peak_force),
            sliding_distance=_column(sliding_distance),
            peak_force_se=_column(peak_force_se),
            sliding_distance_se=_column(sliding_distance_se),
            mass=_column(mass),
            stroke=_column(stroke),
            order=_column(order),
            condition=[condition],
        )
        seen = self._count(push, source, name, content or digest_push(push))
        seen.reason = reason
        if reason is None:
            self._take(seen, push)
        self.kept = [*self.kept, seen][-KEPT:]
        if seen.log_evidence is not None and seen.log_evidence >= 0:
            seen.alarm = True
            self._raise_alarm(seen)
        return seen

    def record(
        self, recording: Recording, *, source: str = "", content: str | None = None
    ) -> PushRecord:
        """Take one recorded push, which is reduced by itself, with its own noise.

        It can be called where `acquire` calls `on_push`. A push that cannot be reduced is counted,
        with the reason. Raises `InputError` as `update` does.
        """
        content = content or digest_recording(recording)
        said: dict[str, Any] = {
            "mass": recording.mass,
            "stroke": recording.stroke,
            "condition": recording.condition,
            "order": recording.order,
            "name": recording.name,
            "source": source,
            "content": content,
        }
        self.check(source, recording.name, content, recording.order)
        try:
            alone = check_data(Recordings((recording,)), self.setup.rig, use_data_mass=True)
            push = reduce_recordings(alone).pushes
        except DifffricError as error:
            return self.update(recording.velocity, reason=" ".join(str(error).split()), **said)
        return self.update(
            recording.velocity,
            float(push.peak_force[0]),
            float(push.sliding_distance[0]),
            peak_force_se=float(push.peak_force_se[0]),
            sliding_distance_se=float(push.sliding_distance_se[0]),
            **said,
        )

    def check(self, source: str, name: str, content: str, order: float) -> None:
        """Raise `InputError` where a push may not come next: it was counted already, by its digest
        `content`, or its order in its `source` goes back."""
        where = ": ".join(filter(None, [source, name])) or f"push {self.count + 1}"
        if content in self.contents:
            back = len(self.contents) - self.contents.index(content) - 1
            raise InputError(
                f"{where}: the same push as number {self.count - back}, which is counted already "
                "(two pushes that read alike need an order each)"
            )
        last = self.orders.get(source)
        if last is not None and order <= last:
            raise InputError(f"{where}: its order is {order:g} after {last:g}: expected it to grow")

    def _count(self, push: Pushes, source: str, name: str, content: str) -> PushRecord:
        """Count a push, after `check`, and return its record."""
        order = float(push.order[0])
        self.check(source, name, content, order)
        self.contents = [*self.contents, content][-_REMEMBERED:]
        if not math.isnan(order):
            self.orders[source] = order
        self.count += 1
        return PushRecord(
            number=self.count,
            source=source,
            name=name,
            velocity=float(push.velocity[0]),
            condition=push.condition[0],
            mass=_or_none(push.mass[0]),
            stroke=_or_none(push.stroke[0]),
            order=_or_none(order),
            peak_force=_or_none(push.peak_force[0]),
            sliding_distance=_or_none(push.sliding_distance[0]),
        )

    def _take(self, seen: PushRecord, push: Pushes) -> None:
        """Read a push, hold it against those before, and add it to them."""
        level = self.levels.get(self._find_part(seen))
        reading = self.reader.read(push, level and level.log_mu_s[0])
        if reading.reason[0] is not None:
            seen.reason = reading.reason[0]
            return
        self.identified += 1
        y, c = float(reading.log_mu_s[0]), float(reading.contrast[0])
        error = float(reading.error[0])
        seen.log_mu_s, seen.mu_s = y, math.exp(y)
        seen.standard_error, seen.contrast = math.exp(y) * error, _or_none(c)
        seen.h = self.scatter**2 + error**2
        seen.cell = self._find_cell(seen, [_or_none(s) for s in reading.sigma[0].tolist()])
        z = self._judge(seen)
        if any(x is not None for x in z):
            self.judged += 1
            numbers = np.array([np.nan if x is None else x for x in z])
            self.log_R = shiryaev_roberts.update(self.log_R, numbers)
        seen.z = z
        share = float(shiryaev_roberts.total(self.log_R)) - self.log_threshold
        seen.log_evidence = share if math.isfinite(share) else None
        parts = (shiryaev_roberts.by_direction(self.log_R) - self.log_threshold).tolist()
        seen.log_evidence_by = [x if math.isfinite(x) else None for x in parts]
        self._follow(seen)
        if self.alarms and seen.number <= self.alarms[-1].push + WATCHED:
            self.alarms[-1].after.append(make_after(seen))

    def _judge(self, seen: PushRecord) -> list[float | None]:
        """Hold both numbers of a push against those before, and add them to their means."""
        cell = str(seen.cell)
        z = []
        for j, (channel, y, h) in enumerate(
            ((self.friction, seen.log_mu_s, seen.h), (self.contrast, seen.contrast, 1.0))
        ):
            if y is None or h is None:
                z.append(None)
                continue
            found = channel.judge(y, h, cell)
            seen.squares[j], seen.taken[j] = found.squares, found.taken
            z.append(found.z)
        return z

    def _follow(self, seen: PushRecord) -> None:
        """Bring the level of the push's part up to date."""
        cell = self.cells[str(seen.cell)]
        level = self.levels.setdefault(cell.part, Level())
        phi = self.friction.get_spread(str(seen.cell)).phi or 1.0
        assert seen.log_mu_s is not None and seen.h is not None
        level.see(str(seen.cell), seen.log_mu_s, phi * seen.h, (WANDER * self.scatter) ** 2)
        x, error = level.log_mu_s
        seen.state, seen.state_se = math.exp(x), math.exp(x) * error

    def _find_cell(self, seen: PushRecord, sigma: list[float | None]) -> str:
        """Return the key of a push's cell; where there is none, make it."""
        measured = "both" if None not in sigma else "force" if sigma[1] is None else "distance"
        part = self._find_part(seen)
        for key, cell in self.cells.items():
            if (
                (cell.part, cell.measured) == (part, measured)
                and _near(cell.velocity, seen.velocity, _SAME_SPEED)
                and _near(cell.stroke, seen.stroke, _SAME_SPEED)
            ):
                cell.sigma = sigma
                return key
        key = str(len(self.cells) + 1)
        self.cells[key] = Cell(part, seen.velocity, seen.mass, seen.stroke, measured, sigma)
        return key

    def _find_part(self, seen: PushRecord) -> str:
        """Return the key of a push's part; where there is none, make it."""
        for key, (condition, mass) in self.parts.items():
            if condition == seen.condition and _near(mass, seen.mass, _SAME_MASS):
                return key
        key = str(len(self.parts) + 1)
        self.parts[key] = [seen.condition, seen.mass]
        return key

    def _raise_alarm(self, seen: PushRecord) -> None:
        """Raise the alarm of a push, and let the baselines begin anew from the estimated change."""
        since = [x for x in self.kept if x.number >= self.begun and x.cell is not None]
        change = date_change(since)
        after = since[change.step :]
        before = remove_pushes(self.friction, after, 0), remove_pushes(self.contrast, after, 1)
        self.alarms.append(make_alarm(seen, since, change, self.cells, before))
        self.friction, self.contrast = (Baseline(x.prior, {}, x.spreads) for x in before)
        self.log_R, self.begun = shiryaev_roberts.start(), seen.number + 1
        for level in self.levels.values():
            level.forget()
        for x in after:
            self._judge(replace(x, squares=[0.0, 0.0], taken=[False, False]))
            self._follow(x)

    def as_dict(self) -> dict:
        """Return all that the monitor knows but its set-up, as JSON can hold it."""
        return {
            "arl": self.arl,
            "count": self.count,
            "identified": self.identified,
            "judged": self.judged,
            "begun": self.begun,
            "cells": {k: asdict(x) for k, x in self.cells.items()},
            "parts": self.parts,
            "friction": self.friction.as_dict(),
            "contrast": self.contrast.as_dict(),
            "levels": {k: asdict(x) for k, x in self.levels.items()},
            "log_R": [[x if math.isfinite(x) else None for x in r] for r in self.log_R.tolist()],
            "orders": self.orders,
            "contents": self.contents,
            "alarms": [x.as_dict() for x in self.alarms],
            "kept": [asdict(x) for x in self.kept],
        }

    @classmethod
    def read(cls, setup: Setup | Rig, saved: dict) -> Monitor:
        """Return a monitor that goes on from what `as_dict` gave, for the same set-up."""
        new = cls(setup, arl=saved["arl"])
        for name in ("count", "identified", "judged", "begun", "parts", "orders", "contents"):
            setattr(new, name, saved[name])
        new.cells = {k: Cell(**x) for k, x in saved["cells"].items()}
        new.friction, new.contrast = (
            Baseline.read(saved["friction"]),
            Baseline.read(saved["contrast"]),
        )
        new.levels = {k: Level(**x) for k, x in saved["levels"].items()}
        new.log_R = np.array([[-np.inf if x is None else x for x in r] for r in saved["log_R"]])
        new.alarms = [Alarm.read(x) for x in saved["alarms"]]
        new.kept = [PushRecord(**x) for x in saved["kept"]]
        return new


def _near(a: float | None, b: float | None, share: float) -> bool:
    """Whether two numbers differ by no more than a share of the first; two missing ones do not."""
    if a is None or b is None:
        return a is b
    return abs(a - b) <= share * a


def _column(x: float) -> NDArray:
    """A column of one row."""
    return np.array([x], float)


def _or_none(x: float) -> float | None:
    """A number, None in place of NaN and infinity."""
    return float(x) if math.isfinite(x) else None
