"""A member of a fleet: one rig's diagnosis, kept on disk, and what its pushes say of an effect that
other rigs have."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from difffric.atomic_files import write_whole
from difffric.diagnosis.procedure import diagnose
from difffric.diagnosis.score_test import compute_p_value, run_score_tests
from difffric.diagnosis.start import fit_plain_model, prepare_start
from difffric.diagnosis.verdict import UNEXPLAINED, Diagnosis
from difffric.errors import DifffricError
from difffric.estimation.ensembles import ensemble as en
from difffric.estimation.ensembles import ensemble_refits
from difffric.fleet.archive import ArchiveFile
from difffric.fleet.features import MADE_WITH
from difffric.fleet.sample import MOST, sample
from difffric.measurements.quantities import shorten_to_line
from difffric.output_folder import to_json_types
from difffric.progress import silent
from difffric.rig import catalogue
from difffric.rig.catalogue import RATIO, numbers_of
from difffric.rig.setup import Setup
from difffric.rig.setup_toml import read_setup, write_setup

LAYOUT = 1
"""Version of what is kept of a rig: what has another one is made anew."""
RESULT, SETUP, ASKED = "result.json", "setup.toml", "asked-"
_ROUNDS = 40
"""The most steps of a fit with an effect's size held; it ends before where it has settled."""


@dataclass(frozen=True)
class Member:
    """A rig of a fleet that is to be diagnosed."""

    name: str
    sources: tuple[ArchiveFile, ...]
    setup: Setup
    digest: str
    """of the content of its set-up's file"""
    folder: str
    """where its answer is kept"""
    options: tuple[tuple[str, Any], ...] = ()
    """of `diagnose`"""

    @property
    def key(self) -> str:
        """Digest of all that decides the answer: files, set-up, options, this library."""
        files = [(s.name, s.size, s.changed) for s in self.sources]
        said = [MADE_WITH, LAYOUT, MOST, files, self.digest, self.options]
        return hashlib.sha256(repr(said).encode()).hexdigest()[:32]

    @property
    def answer(self) -> dict | None:
        """The answer on disk; None where there is none that was made from what is there now."""
        return _load_answer(Path(self.folder) / RESULT, self.key)


@dataclass(frozen=True)
class Question:
    """Whether a rig could have an effect of a size within a range, which other rigs have."""

    rig: Member
    effect: str
    sizes: tuple[tuple[str, tuple[float, ...]], ...]
    """key -> sizes that are tried [SI, as files write them], as many of each key"""

    @property
    def key(self) -> str:
        """Digest of all that decides the answer."""
        said = [self.rig.key, self.effect, self.sizes]
        return hashlib.sha256(repr(said).encode()).hexdigest()[:32]

    @property
    def path(self) -> Path:
        """The file that the answer is kept in."""
        return Path(self.rig.folder) / f"{ASKED}{self.effect}.json"

    @property
    def answer(self) -> dict | None:
        """The answer on disk; None where there is none that was made from what is there now."""
        return _load_answer(self.path, self.key)


def examine(rig: Member) -> str | None:
    """Diagnose a rig and keep the answer in its folder.

    Returns None, or in words why the rig could not be diagnosed. Workers run it, so it raises
    nothing.
    """
    jax.config.update("jax_enable_x64", True)  # a worker's own process has not
    try:
        some = sample(rig.sources, channels=rig.setup.channels)
        found = diagnose(rig.setup, some.data, skip_bad=True, **dict(rig.options))
    except Exception as error:  # whatever it is, the other rigs are to have their answers
        return _word_reason(error)
    folder = Path(rig.folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_setup(found.setup, folder / SETUP)
    answer = {
        "rig": rig.name,
        "files": len(rig.sources),
        "files_used": some.files,
        "pushes": len(found.mu_s),
        "recordings": found.used_recordings,
        "left_out": list(some.notes),
        "known": sorted(_list_effects(rig.setup)),
        "diagnosis": found.as_dict(),
        "evidence": collect_evidence(found),
    }
    _save_answer(folder / RESULT, rig.key, answer)
    return None


def collect_evidence(found: Diagnosis) -> dict[str, dict]:
    """Collect what a rig's diagnosis says for each effect that was looked for.

    Each effect has `chi2_drop`, with as many degrees of freedom as `numbers`, and its `p_value`,
    corrected for the looks at this effect but not for other effects. The drop of a cause is that of
    its refit. That of another effect is by the score test on top of the final model (with `at` and
    `visible`, see `score_test.Score`), else, where there is no cause, by the refit on top of the
    plain model; it is 0 where nothing spoke for the effect. Where the misfit is unexplained the
    answer is empty, as a model that is wrong is evidence of nothing.
    """
    if found.verdict == UNEXPLAINED:
        return {}
    data, base = found.state.data, found.state.extended
    task = data.task
    names = [task.model.coordinates.names[i] for i in base.extra[0]]
    there = {RATIO if name == numbers_of(RATIO)[0] else name.partition(".")[0] for name in names}
    wanted = [e for e in data.looked_for if e not in there]
    scores = run_score_tests(task, base, wanted)
    refitted = {} if found.causes else {c.id: c.chi2_drop for c in found.considered}
    out = {}
    for effect in wanted:
        score = scores.get(effect)
        drop = refitted.get(effect, 0.0) if score is None else score.drop
        out[effect] = _describe_evidence(effect, drop)
        if score is not None:
            out[effect] |= {"at": score.at, "visible": score.visible}
    return out | {cause.id: _describe_evidence(cause.id, cause.chi2_drop) for cause in found.causes}


def _list_effects(setup: Setup) -> set[str]:
    """Ids of the effects that a set-up has already."""
    return {name.partition(".")[0] for name in catalogue.parameter_names(setup.rig)}


def _describe_evidence(effect: str, drop: float) -> dict:
    drop = max(float(drop), 0.0)
    p = compute_p_value(effect, drop, 1)
    return {"chi2_drop": drop, "numbers": len(numbers_of(effect)), "p_value": p}


def ask(question: Question) -> str | None:
    """Fit a rig with the effect held at each of the sizes, all else free, and keep by how much the
    best of these fits is worse than the rig's own model.

    Returns None, or in words why that could not be done. Workers run it, so it raises nothing.
    """
    jax.config.update("jax_enable_x64", True)
    rig = question.rig
    try:
        some = sample(rig.sources, channels=rig.setup.channels)
        extended = read_setup(Path(rig.folder) / SETUP)
        mass = dict(rig.options).get("use_data_mass", False)
        start = prepare_start(extended, some.data, silent, use_data_mass=mass, skip_bad=True)
        task = start.data.task
        base = fit_plain_model(task, start.at, start.guess)
        excess = compute_excess(task, base, question.effect, dict(question.sizes))
    except Exception as error:  # whatever it is, the other rigs are to have their answers
        return _word_reason(error)
    _save_answer(question.path, question.key, {"effect": question.effect, "excess": excess})
    return None


def compute_excess(task: en.EnsembleTask, base: en.Fits, effect: str, sizes: Mapping) -> float:
    """Return by how much -2 log likelihood with the effect at the best of some sizes is above that
    of `base`, the fit of the rig's own model.

    `sizes` has as many numbers for each key of the effect. Each size is fitted twice, from `base`
    and from equal mu_s of all pushes, and the better fit counts.
    """
    coordinates = task.model.coordinates
    names = numbers_of(effect)
    keys = ["ratio" if effect == RATIO else name.partition(".")[2] for name in names]
    rows = []
    for values in zip(*(sizes[key] for key in keys), strict=True):
        point = coordinates.point(dict(zip(names, values, strict=True)))
        ends = [coordinates.bounds(name) for name in names]
        rows.append([np.clip(x, *end) for x, end in zip(point, ends, strict=True)])
    index = coordinates.indices(names)
    one = base.pick(np.zeros(len(rows), int))
    c = one.c.copy()
    c[:, index] = rows
    one = replace(one, c=c, gram=None, residual=None, damping=None)
    level = replace(one, own=np.zeros_like(one.own))
    every = en.join(one, level) if task.mu_free else one
    there = ensemble_refits.refit(task, every, _ROUNDS)
    return float(np.min(en.criterion(task, there)) - en.criterion(task, base)[0])


def _word_reason(error: Exception) -> str:
    """Return an error in one line; of an error that nobody foresaw, its type too."""
    words = shorten_to_line(" ".join(str(error).split()))
    return words if isinstance(error, DifffricError) else f"{type(error).__name__}: {words}"


def _load_answer(path: Path, key: str) -> dict | None:
    """Return what a file holds; None where there is none, or one with another key."""
    try:
        known = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    return known if isinstance(known, dict) and known.get("key") == key else None


def _save_answer(path: Path, key: str, answer: Mapping) -> None:
    text = json.dumps(to_json_types({"key": key, **answer}), indent=1, allow_nan=False) + "\n"
    write_whole(path, lambda file: file.write(text.encode()))
