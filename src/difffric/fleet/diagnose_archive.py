"""A fleet diagnosed: each rig on its own data, then what the rigs share and which of them differ.

As in `fleet`, what is on disk stays true at any moment: each rig's answer appears whole, with a key
that says what it was made from, and a second run does only what is missing or has changed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from difffric.compute.precision import require_float64
from difffric.diagnosis.procedure import NEGLIGIBLE, PUSH, SPEED
from difffric.diagnosis.shape_scan import SHAPED
from difffric.errors import InputError
from difffric.estimation.extended_model import PRESLIDING
from difffric.fleet.archive import Source, find
from difffric.fleet.identify_archive import escaped, setups_of
from difffric.fleet.member import ASKED, RESULT, SETUP, Question, Rig, ask, examine
from difffric.fleet.shared_effects import CAUSES, Combined, combined, differing
from difffric.fleet.verdict import FleetDiagnosis
from difffric.fleet.workers import Lost, Runner, workers
from difffric.output_folder import open_folder
from difffric.progress import Tell, silent
from difffric.rig.catalogue import numbers_of

RIGS = "rigs"
_FIRST = 0.8
"""Share of the work that the diagnoses are taken to be."""


def diagnose_fleet(
    archive: str | os.PathLike,
    out: str | os.PathLike,
    *,
    setup: str | os.PathLike | None = None,
    n_workers: int = 1,
    scheduler: str | None = None,
    negligible: float = NEGLIGIBLE,
    held_out: str = PUSH,
    use_data_mass: bool = False,
    tell: Tell = silent,
) -> FleetDiagnosis:
    """Diagnose each rig of an archive (`fleet_archive.find`) on at most 40 of its pushes, into
    `out`, and find the effects that rigs share and the rigs that differ.

    `n_workers` and `scheduler` as in `identify_fleet`, the other options as in `diagnose`. A rig
    is a task; one that cannot be diagnosed is listed with its reason. One run at a time may write
    to a folder.

    Raises `InputError` where no rig can be diagnosed, for files without a set-up, for a `setup`
    that cannot be read, without dask.distributed, and where `out` cannot be written.
    """
    require_float64()
    if held_out not in (PUSH, SPEED):
        raise InputError(f"held_out: expected {PUSH!r} or {SPEED!r}, got {held_out!r}")
    out = Path(out)
    tell("looking for files", 0.0)
    sources = find(archive, setup, out)
    setups, broken = setups_of(sources, setup)
    files: dict[str, list[Source]] = {}
    for source in sources:
        files.setdefault(source.rig, []).append(source)
    options = {"negligible": negligible, "held_out": held_out, "use_data_mass": use_data_mass}
    with open_folder(out), workers(n_workers, scheduler) as run:
        kept = (out / RIGS).absolute()
        rigs = {
            name: Rig(
                name, tuple(files[name]), *known, str(kept / escaped(name)), (*options.items(),)
            )
            for name, known in setups.items()
        }
        bad = dict(broken)
        new = [rig for rig in rigs.values() if rig.answer is None]
        for done, (rig, why) in enumerate(run(examine, new), 1):
            if why is not None:
                bad[rig.name] = f"its process died: {why}" if isinstance(why, Lost) else why
            tell(f"diagnosing, {done} of {len(new)} rigs", _FIRST * done / len(new))
        answers = {name: answer for name, rig in rigs.items() if (answer := rig.answer)}
        _tidy(kept, [Path(rigs[name].folder) for name in answers])
        if not answers:
            rig, why = next(iter(sorted(bad.items())))
            raise InputError(f"{archive}: none of {len(files)} rigs can be diagnosed: {rig}: {why}")
        found = combined(answers.values())
        excess, asked = _asked(rigs, found, run, tell)
    return FleetDiagnosis(
        out, answers, found, excess, differing(found, excess), tuple(sorted(bad.items())),
        len(new), asked,
    )  # fmt: skip


def _asked(rigs, found: Combined, run: Runner, tell: Tell) -> tuple[dict, int]:
    """(what each rig without a common effect says of it, how many were fitted for it)."""
    questions = [q for one in found.shared for q in _questions(rigs, one)]
    new = [q for q in questions if q.answer is None]
    # One that could not be asked has no answer, and differs in nothing.
    for done, _ in enumerate(run(ask, new), 1):
        share = _FIRST + (1 - _FIRST) * done / len(new)
        tell(f"holding rigs against what others share, {done} of {len(new)}", share)
    known = {(q.effect, q.rig.name): q.answer for q in questions}
    return {key: answer["excess"] for key, answer in known.items() if answer}, len(new)


def _questions(rigs, one) -> list[Question]:
    """To the rigs without an effect that most have, where its size says all of it."""
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
    """Take out what was kept of rigs that are no longer there, or not as they were."""
    for path in folder.iterdir() if folder.is_dir() else ():
        if path in expected or not _ours(path / RESULT):
            continue
        for file in (path / RESULT, path / SETUP, *path.glob(f"{ASKED}*.json")):
            file.unlink(missing_ok=True)
        with suppress(OSError):  # something else lies there
            path.rmdir()


def _ours(path: Path) -> bool:
    try:
        known = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return False
    return isinstance(known, dict) and {"key", "evidence", "rig"} <= known.keys()
