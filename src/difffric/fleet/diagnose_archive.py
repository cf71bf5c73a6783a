"""Diagnose an archive: each rig on its own data, then what the rigs share and which of them differ.

As in `identify_archive`, what is on disk is true at any moment: each rig's answer appears whole,
with a key that says what it was made from, and a second run does only what is missing or has
changed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from difffric.compute.precision import require_float64
from difffric.diagnosis.procedure import MATTERS, PUSH, SPEED
from difffric.diagnosis.shape_scan import SHAPED
from difffric.errors import InputError
from difffric.estimation.extended_model import PRESLIDING
from difffric.fleet.archive import ArchiveFile, find_files
from difffric.fleet.identify_archive import GOES_ON, escape, read_setups
from difffric.fleet.member import ASKED, RESULT, SETUP, Member, Question, ask, examine
from difffric.fleet.shared_effects import CAUSES, Combined, combine, find_different
from difffric.fleet.verdict import FleetDiagnosis
from difffric.fleet.workers import Lost, Runner, start_workers
from difffric.known_so_far import KEPT_ON_DISK, tell_known
from difffric.output_folder import open_folder
from difffric.progress import Tell, silent
from difffric.rig.catalogue import numbers_of

RIGS = "rigs"
_FIRST = 0.8
"""Share of the work that the diagnoses are taken to be, for the progress that is shown."""


def diagnose_fleet(
    archive: str | os.PathLike,
    out: str | os.PathLike,
    *,
    setup: str | os.PathLike | None = None,
    n_workers: int = 1,
    scheduler: str | None = None,
    matters: float = MATTERS,
    held_out: str = PUSH,
    use_data_mass: bool = False,
    tell: Tell = silent,
) -> FleetDiagnosis:
    """Diagnose each rig of an archive, then find what the rigs share and which of them differ.

    `archive` and `setup` are as in `fleet.archive.find_files`. Each rig is diagnosed on at most 40
    of its pushes, and its answer is written into a folder of its own within `out`.

    `n_workers` and `scheduler` are as in `identify_fleet`, the other options as in `diagnose`. Each
    rig is a task; one that cannot be diagnosed is listed with its reason. One run at a time may
    write to a folder.

    Raises `InputError` where no rig can be diagnosed, for files without a set-up, for a `setup`
    that cannot be read, without dask.distributed, and where `out` cannot be written.
    """
    require_float64()
    if held_out not in (PUSH, SPEED):
        raise InputError(f"held_out: expected {PUSH!r} or {SPEED!r}, got {held_out!r}")
    out = Path(out)
    tell("looking for files", 0.0)
    sources = find_files(archive, setup, out)
    setups, broken = read_setups(sources, setup)
    files: dict[str, list[ArchiveFile]] = {}
    for source in sources:
        files.setdefault(source.rig, []).append(source)
    options = {"matters": matters, "held_out": held_out, "use_data_mass": use_data_mass}
    with open_folder(out), start_workers(n_workers, scheduler) as run:
        kept = (out / RIGS).absolute()
        rigs = {
            name: Member(
                name, tuple(files[name]), *known, str(kept / escape(name)), (*options.items(),)
            )
            for name, known in setups.items()
        }
        bad = dict(broken)
        new = [rig for rig in rigs.values() if rig.answer is None]
        for done, (rig, why) in enumerate(run(examine, new), 1):
            if why is not None:
                bad[rig.name] = f"its process died: {why}" if isinstance(why, Lost) else why
            tell(f"diagnosing, {done} of {len(new)} rigs", _FIRST * done / len(new))
            tell_known(KEPT_ON_DISK, f"the answers of {done} of {len(new)} rigs{GOES_ON}")
        answers = {name: answer for name, rig in rigs.items() if (answer := rig.answer)}
        _tidy(kept, [Path(rigs[name].folder) for name in answers])
        if not answers:
            rig, why = next(iter(sorted(bad.items())))
            raise InputError(f"{archive}: none of {len(files)} rigs can be diagnosed: {rig}: {why}")
        found = combine(answers.values())
        excess, asked = _ask_members(rigs, found, run, tell)
    return FleetDiagnosis(
        folder=out,
        answers=answers,
        found=found,
        excess=excess,
        differ=find_different(found, excess),
        bad=tuple(sorted(bad.items())),
        fresh=len(new),
        asked=asked,
    )


def _ask_members(rigs, found: Combined, run: Runner, tell: Tell) -> tuple[dict, int]:
    """Ask each rig without a common effect whether it could have it.

    Returns (effect, rig) -> by how much its -2 log likelihood grows with the effect, and how many
    rigs were fitted for that in this run.
    """
    questions = [q for one in found.shared for q in _pose_questions(rigs, one)]
    new = [q for q in questions if q.answer is None]
    # One that could not be asked has no answer, and differs in nothing.
    for done, _ in enumerate(run(ask, new), 1):
        share = _FIRST + (1 - _FIRST) * done / len(new)
        tell(f"holding rigs against what others share, {done} of {len(new)}", share)
    known = {(q.effect, q.rig.name): q.answer for q in questions}
    return {key: answer["excess"] for key, answer in known.items() if answer}, len(new)


def _pose_questions(rigs, one) -> list[Question]:
    """Return the questions to the rigs without a shared effect.

    There are none where most rigs lack the effect, and where its size does not say all of it (a
    shape with a place or a wavelength).
    """
    names = [x.partition(".")[2] or "ratio" for x in numbers_of(one.effect)]
    whole = (
        one.effect not in SHAPED and one.effect != PRESLIDING and set(names) == set(one.parameters)
    )
    if one.by != CAUSES or not one.common or not whole:
        return []
    return [
        Question(rigs[rig], one.effect, one.range)
        for rig in one.without
        if one.effect in rigs[rig].answer["evidence"]
    ]


def _tidy(folder: Path, expected: Sequence[Path]) -> None:
    """Remove what was kept of rigs that are no longer there, or not as they were."""
    for path in folder.iterdir() if folder.is_dir() else ():
        if path in expected or not _is_ours(path / RESULT):
            continue
        for file in (path / RESULT, path / SETUP, *path.glob(f"{ASKED}*.json")):
            file.unlink(missing_ok=True)
        with suppress(OSError):  # something else lies there
            path.rmdir()


def _is_ours(path: Path) -> bool:
    """Whether a file is the answer of a rig, as `member.examine` keeps it."""
    try:
        known = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(known, dict) and {"key", "evidence", "rig"} <= known.keys()
