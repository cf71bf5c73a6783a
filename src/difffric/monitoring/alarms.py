"""Alarms: what a monitor says when something has changed, and keeps for finding the cause."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from difffric.monitoring import shiryaev_roberts
from difffric.monitoring.baseline import Baseline, Mean
from difffric.monitoring.change_cause import After, ChangeCause, Setting, find_causes
from difffric.monitoring.change_point import Change, find_change
from difffric.monitoring.readings import Reader
from difffric.monitoring.records import Cell, PushRecord


@dataclass
class Alarm:
    """Something has changed."""

    push: int
    """number of the push that raised it"""
    change: int
    """number of the first push after the change, as estimated"""
    kind: str
    """`step`, `drift`, or `step or drift`"""
    direction: str
    """where most of the evidence is (`shiryaev_roberts.DIRECTIONS`)"""
    settings: dict[str, Setting]
    """cell -> its pushes before the change"""
    after: list[After]
    """the pushes from the change on"""

    def causes(self, reader: Reader) -> list[ChangeCause]:
        """What may have changed, by all pushes since; the likeliest first."""
        return find_causes(reader, self.settings, self.after)

    def as_dict(self) -> dict:
        """Return the alarm as a state file holds it, each setting and push as a list of numbers."""
        return {
            "push": self.push,
            "change": self.change,
            "kind": self.kind,
            "direction": self.direction,
            "settings": {cell: setting.as_list() for cell, setting in self.settings.items()},
            "after": [x.as_list() for x in self.after],
        }

    @classmethod
    def read(cls, saved: Mapping) -> Alarm:
        """Return the alarm that `as_dict` gave."""
        settings = {cell: Setting.read(x) for cell, x in saved["settings"].items()}
        after = [After.read(x) for x in saved["after"]]
        return cls(**{**saved, "settings": settings, "after": after})


def date_change(since: Sequence[PushRecord]) -> Change:
    """Estimate when the numbers of pushes have changed; `since` are those since the last alarm."""
    return find_change(np.array([[np.nan if v is None else v for v in x.z] for x in since]))


def make_alarm(
    seen: PushRecord,
    since: Sequence[PushRecord],
    change: Change,
    cells: Mapping[str, Cell],
    before: tuple[Baseline, Baseline],
) -> Alarm:
    """Make the alarm that a push has raised.

    `since` are the pushes since the last alarm, and `change` is where they have changed. `before`
    are the baselines of friction and contrast without the pushes after the change.
    """
    parts = [-np.inf if x is None else x for x in seen.log_evidence_by]
    return Alarm(
        push=seen.number,
        change=since[change.first].number,
        kind=change.kind,
        direction=shiryaev_roberts.DIRECTIONS[int(np.argmax(parts))],
        settings=_describe_settings(cells, before),
        after=[make_after(x) for x in since[change.step :]],
    )


def make_after(seen: PushRecord) -> After:
    """Return what an alarm keeps of an identified push after the change."""
    assert seen.cell is not None and seen.log_mu_s is not None and seen.h is not None
    contrast = np.nan if seen.contrast is None else seen.contrast
    return After(seen.cell, seen.log_mu_s, seen.h, contrast)


def remove_pushes(channel: Baseline, pushes: Iterable[PushRecord], which: int) -> Baseline:
    """Return the baseline of friction (`which` 0) or contrast (1) as it was without some pushes."""
    pushes = list(pushes)
    means, spreads = dict(channel.means), {k: replace(x) for k, x in channel.spreads.items()}
    for key in dict.fromkeys(str(x.cell) for x in pushes):
        mine = [x for x in pushes if x.cell == key and x.taken[which]]
        numbers = [(x.log_mu_s, x.h) if which == 0 else (x.contrast, 1.0) for x in mine]
        means[key] = channel.get_mean(key).remove(
            [(y, h) for y, h in numbers if y is not None and h is not None]
        )
    for x in pushes:
        if x.squares[which]:
            spread = spreads[str(x.cell)]
            spread.squares -= x.squares[which]
            spread.count -= 1
    return Baseline(channel.prior, {k: Mean(m.weight, m.value) for k, m in means.items()}, spreads)


def _describe_settings(
    cells: Mapping[str, Cell], before: tuple[Baseline, Baseline]
) -> dict[str, Setting]:
    """Return what was known of each cell before the change; cells without a push are left out."""
    settings = {}
    for key, cell in cells.items():
        means = [channel.get_mean(key) for channel in before]
        if means[0].weight == 0:
            continue
        spreads = [channel.get_spread(key) for channel in before]
        phis = [spread.phi or 1.0 for spread in spreads]
        settings[key] = Setting(
            velocity=cell.velocity,
            mass=np.nan if cell.mass is None else cell.mass,
            stroke=np.nan if cell.stroke is None else cell.stroke,
            sigma=tuple(np.inf if x is None else x for x in cell.sigma),
            log_mu_s=means[0].value,
            contrast=means[1].value if means[1].weight else np.nan,
            variances=tuple(
                phi / mean.weight if mean.weight else np.inf
                for phi, mean in zip(phis, means, strict=True)
            ),
            spreads=tuple(phis),
            counts=tuple(spread.count for spread in spreads),
        )
    return settings
