"""Given measured data: what the simulation gets wrong, the cause, and what mending it gains.

The plain model is fitted; then one effect after the other is looked for on top of what is there,
kept where it is significant, gains on held-out pushes and matters, and dropped again where later
ones made it needless.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from difffric.compute.precision import require_float64
from difffric.diagnosis import exploration as search
from difffric.diagnosis.alternatives import alternatives
from difffric.diagnosis.candidates import LOCAL
from difffric.diagnosis.causes import cause_of
from difffric.diagnosis.exploration import Candidate, Score
from difffric.diagnosis.extended_setup import extended_rig, extended_setup, stripped
from difffric.diagnosis.impossible_measurements import Certificate, unreachable
from difffric.diagnosis.lack_of_fit import far, lack_of_fit
from difffric.diagnosis.location import Location, locate, with_forms
from difffric.diagnosis.misfit import misfits
from difffric.diagnosis.next_experiment import Experiment, next_experiment
from difffric.diagnosis.start import folds_of, start_of
from difffric.diagnosis.starts import best_base, relieved
from difffric.diagnosis.verdict import (
    ADEQUATE,
    AMBIGUOUS,
    NAMED,
    UNEXPLAINED,
    Cause,
    Diagnosis,
    Gain,
)
from difffric.errors import InputError, NumericalError
from difffric.estimation import ensemble as en
from difffric.estimation import ensemble_refits
from difffric.estimation.ensemble import Fits
from difffric.estimation.extended_model import PRESLIDING, SLIDES
from difffric.measurements.pushes import Pushes
from difffric.measurements.recordings import Recordings
from difffric.progress import Tell, silent
from difffric.rig.catalogue import KEYS, RATIO, numbers_of
from difffric.rig.rig import Rig
from difffric.rig.setup import Setup

PUSH, SPEED = "push", "speed"
SIGNIFICANT = 1e-3
"""An effect is named where chance gives as much with less than this probability."""
NEGLIGIBLE = 0.1
"""Share of the plain model's systematic error on held-out pushes below which a cause is listed,
not added."""
LEFT = 0.3
"""Share of it that, left over, makes the misfit unexplained."""
MOST = 3
"""Causes that are looked for at most."""
ALIKE = 2 * np.log(20.0)
"""Drops of -2 log likelihood within this of each other do not tell two effects apart."""
_RELIEVED = 3
"""How often the search begins anew where the fit that it extends turns out not to be the best."""
_STANDS_OUT = 4.0
"""Standard deviations of chi-square."""
_FEWEST = 3
"""Pushes from which on one can be held out."""
_VISIBLE = 3.0
"""Standard deviations at its typical size from which an effect can be seen."""
_SAME = 0.01
"""Relative difference of the mean mu_s up to which two plain fits are the same."""
_HIDING = 6
"""Steps in which the plain model takes up what an invisible effect does."""


def diagnose(
    rig: Rig | Setup,
    data: Pushes | Recordings,
    *,
    negligible: float = NEGLIGIBLE,
    held_out: str = PUSH,
    use_data_mass: bool = False,
    skip_bad: bool = False,
    tell: Tell = silent,
) -> Diagnosis:
    """Show what the rig's simulation gets wrong in measured pushes, name the cause, extend the
    rig by it and measure the gain on held-out pushes.

    `negligible`: the share of the plain model's systematic error below which a cause is listed
    and not added. `held_out`: "push", or "speed" to hold out all pushes of one speed at a time.
    Effects that the rig has already stay, and are refitted.

    Raises `InputError` for data that cannot be used, `NumericalError` where the fitted plain model
    gives no number for a push.
    """
    require_float64()
    if held_out not in (PUSH, SPEED):
        raise InputError(f"held_out: expected {PUSH!r} or {SPEED!r}, got {held_out!r}")
    setup = rig if isinstance(rig, Setup) else Setup(rig)
    return _Diagnosis(
        setup, data, negligible, held_out == SPEED, use_data_mass, skip_bad, tell
    ).run()


@dataclass
class _Diagnosis:
    """One call of `diagnose`."""

    setup: Setup
    given: Pushes | Recordings
    share: float
    by_speed: bool
    use_data_mass: bool
    skip_bad: bool
    tell: Tell
    notes: list[str] = field(default_factory=list)
    considered: list[Candidate] = field(default_factory=list)
    """the first round's leaders"""
    certificates: tuple[Certificate, ...] = ()
    compiling: Thread | None = None
    held_plain: float | None = None
    """-2 log likelihood of the held-out pushes without a cause"""

    def run(self) -> Diagnosis:
        """The diagnosis."""
        options = {"use_data_mass": self.use_data_mass, "skip_bad": self.skip_bad}
        start = start_of(self.setup, self.given, self.tell, **options)
        self.fit, self.known, self.data = start.fit, start.known, start.data
        data, task = self.data, self.data.task
        self.folds = folds_of(np.asarray(task.model.pushes.velocity), self.by_speed)
        plain = base = best_base(task, start.at, start.guess)
        if (en.penalised(task, base) >= en.REJECTED).any():
            raise NumericalError(
                "diagnose: the fitted plain model could not be followed through every push"
            )
        before, self.plain_scatter = lack_of_fit(task, plain), plain.scatter
        named: list[tuple[Candidate, tuple[Candidate, ...]]] = []
        small: list[Candidate] = []
        first_scores: dict[str, Score] = {}
        total = None
        if task.n < _FEWEST:
            self.notes.append(
                f"{task.n} pushes: too few to hold any out, and no cause is looked for"
            )
        for k in range(MOST if task.n >= _FEWEST else 0):
            self.tell("looking for a cause", 0.3 + 0.15 * k)
            wanted = [e for e in data.looked_for if e not in self._there(named)]
            wanted = [e for e in wanted if e not in [c.effect for c in small]]
            scores = search.score_tests(task, base, wanted)
            first_scores = first_scores or scores
            if k and self._enough(base, scores):
                break
            if k and self.compiling is None:  # free forms may be needed, and take long to compile
                wide = with_forms(task, data.scales).model
                self.compiling = Thread(target=wide.compile, daemon=True)
                self.compiling.start()
            for _ in range(_RELIEVED):
                found = self._explored(base, wanted, scores, k)
                suspect = far(task, base) or any(c.p_value < SIGNIFICANT for c in found)
                better = relieved(task, base, found) if suspect else None
                if better is None:
                    break
                base = better
                if not named:
                    plain = base
                    before, self.plain_scatter = lack_of_fit(task, plain), plain.scatter
                scores = search.score_tests(task, base, wanted)
            self.considered = self.considered or found
            found = [c for c in found if c.p_value < SIGNIFICANT]
            best = next((c for c in found if self._gains(base, c.fits)), None)
            if best is None:
                break
            total = total or max(before.excess, best.drop)
            if np.sqrt(max(best.drop, 0.0) / total) < self.share:
                small += [c for c in found if c.penalised_drop > 0]
                break
            # Strong effects take many steps: what is left has to be the best fit's.
            new = ensemble_refits.refitted(task, best.fits, 40)
            more, new = self._without_needless(plain, [*named, (best, tuple(found))], new)
            if not self._gains(base, new):
                break
            named, base = more, new
        named = [(best, self._with_alternatives(plain, base, best, x)) for best, x in named]
        self.certificates = unreachable(data.measured, self.setup.rig)
        if self.certificates and not named:
            # The plain model is wrong for certain: what may mend it is in question.
            question = tuple(c for c in self.considered if c.penalised_drop > 0)
            if question:
                named, base = [(question[0], question)], question[0].fits
        return self._result(plain, base, before, named, small, first_scores, total)

    def _explored(self, base: Fits, wanted, scores, k: int) -> list[Candidate]:
        """The leading effects on top of `base`, the best first. Bristles have no null, and take a
        program of their own that takes long: they are looked for where the misfit is large, no
        other effect explains it and they might."""
        data, strong = self.data, far(self.data.task, base)

        def explore(effects, part):
            def tell(share):
                self.tell("looking for a cause", 0.3 + 0.15 * (k + part * share))

            return search.explore(data.task, base, effects, data.scales, scores, tell, strong)

        found = explore([e for e in wanted if e != PRESLIDING], 0.8)
        wanting = strong and not any(self._explains(c) for c in found)
        if (
            PRESLIDING in wanted
            and wanting
            and search.promising(data.task, base, PRESLIDING, data.scales)
        ):
            found += explore([PRESLIDING], 1.0)
        return sorted(found, key=lambda c: -c.penalised_drop)

    def _explains(self, candidate: Candidate) -> bool:
        """Whether an effect leaves no large misfit."""
        return not far(self.data.task, candidate.fits)

    def _of_the_plain_fit(self, plain: Fits) -> list[str]:
        """What its single start says of itself, where that is what the search went on with."""
        task = self.data.task
        away = plain.mu[0, task.condition] + plain.own[0] - np.log(self.fit.mu_s)
        if abs(np.mean(away)) < _SAME:
            return [f"the plain fit: {x}" for x in self.fit.notes]
        return ["the plain fit told here is better than where its single start led (`plain`)"]

    def _there(self, named) -> set[str]:
        """Effects that are in the model already."""
        known = {name.partition(".")[0] for name in self.known}
        return known | {c.effect for c, _ in named}

    def _enough(self, base: Fits, scores: dict[str, Score]) -> bool:
        """Whether nothing is left that a further search could find."""
        left = lack_of_fit(self.data.task, base)
        seen = [search.p_value(e, s.drop, len(scores)) for e, s in scores.items()]
        return (left.p_value is None or left.p_value > 0.01) and min(seen, default=1.0) > 0.01

    def _gains(self, base: Fits, new: Fits) -> bool:
        return self._surprise(new) < self._surprise(replace(base, spread=new.spread))

    def _surprise(self, fits: Fits) -> float:
        """-2 log likelihood of the held-out pushes."""
        return float(ensemble_refits.held_out(self.data.task, fits, self.folds).surprise.sum())

    def _without_needless(self, plain, named, base):
        """Causes that later ones made needless are dropped again."""
        task = self.data.task
        if len(named) < 2:
            return named, base
        for k in range(len(named) - 1):
            effect = named[k][0].effect
            gone = [task.model.coordinates.index(x) for x in numbers_of(effect)]
            c = base.c.copy()
            c[0, gone] = plain.c[0, gone]
            extra = tuple(i for i in base.extra[0] if i not in gone)
            less = replace(base, c=c, extra=(extra,), gram=None, damping=None)
            less = ensemble_refits.refitted(task, less, 15)
            drop = float(en.criterion(task, less)[0] - en.criterion(task, base)[0])
            if search.p_value(effect, drop, len(self.data.looked_for)) > SIGNIFICANT:
                return self._without_needless(plain, named[:k] + named[k + 1 :], less)
        return named, base

    def _result(self, plain, base, before, named, small, scores, total) -> Diagnosis:
        task = self.data.task
        after = lack_of_fit(task, base)
        held = [self._squares(x, base) for x in (plain, base)]
        numbers = task.counts.sum()
        spent = 0 if self.single else task.n * (task.mu_free + task.model.recordings)
        floor = float(np.sqrt(max(numbers - spent, 1) / numbers))
        error = [float(np.sqrt(h.sum() / numbers)) for h in held]
        gain = Gain(error[0], error[1], floor)
        scale = total or max(before.excess, 1.0)
        location = self._unexplained(plain, base, before, after, len(named), scale)
        if location is not None:
            named, base, gain = [], plain, replace(gain, after=gain.before)
            verdict = UNEXPLAINED
        elif not named:
            verdict = UNEXPLAINED if self.certificates else ADEQUATE
        else:
            weak = any(best.p_value > SIGNIFICANT for best, _ in named)
            alike = any(self._alike(*one) for one in named)
            verdict = AMBIGUOUS if weak or alike else NAMED
        if np.max(held) >= en.REJECTED:
            self.notes.append("a held-out push could not be followed: its error is without meaning")
        causes = self._causes(plain, base, named, scores)
        unseen = self._not_visible(scores, {c.effect for c, _ in named})
        experiments = self._experiments(base, named if verdict == AMBIGUOUS else [], unseen)
        rig = extended_rig(stripped(self.setup)[0].rig, task, base)
        return Diagnosis(
            verdict=verdict,
            p_value=before.p_value,
            causes=causes,
            considered=tuple(self._cause(plain, c, (), scores) for c in self.considered),
            certificates=self.certificates,
            negligible=tuple(self._cause(plain, c, (), scores) for c in small),
            location=location,
            gain=gain,
            not_visible=unseen,
            experiments=experiments,
            impossible=self.data.impossible,
            plain=self.fit,
            rig=rig,
            setup=extended_setup(self.setup, rig, task, base),
            mu_s=tuple(np.exp(base.mu[0, task.condition] + base.own[0]).tolist()),
            notes=(*self._of_the_plain_fit(plain), *self.notes),
            misfit=misfits(self.data, plain, base),
            work=(self.data, plain, base, before, after),
        )

    def _experiments(self, base: Fits, ambiguous, unseen) -> tuple[Experiment, ...]:
        """What would tell the first cause from those that look like it, and show what is not
        visible at its typical size."""
        task, pairs = self.data.task, []
        if task.model.kind == SLIDES:
            return ()
        self.tell("looking for the next experiment", 0.96)
        for best, others in ambiguous[:1]:
            alike = self._alike(best, others)
            pairs += [
                ((best.effect, c.effect), best.fits, c.fits) for c in others if c.effect in alike
            ]
        coordinates = task.model.coordinates
        for effect in [e for e in unseen if e not in self.data.impossible]:
            c = base.c.copy()
            names = numbers_of(effect)
            typical = {n: 0.8 if effect == RATIO else KEYS[n][1].typical for n in names}
            c[0, coordinates.indices(names)] = coordinates.point(typical)
            # As large as is typical, and hidden in these data by what else is free.
            there = replace(base, c=c, gram=None, residual=None, damping=None)
            pairs.append(((effect, "plain"), ensemble_refits.refitted(task, there, _HIDING), base))
        return next_experiment(self.data, pairs)

    @property
    def single(self) -> bool:
        """Whether each push has a single number."""
        task = self.data.task
        return task.mu_free and bool((task.counts.sum(axis=1) <= 1).all())

    def _squares(self, fits: Fits, base: Fits) -> NDArray:
        """(1, n) of each held-out push in units of the noise; of one whose single number would be
        fitted by a mu_s of its own, as a free slide's, in units of the plain model's scatter."""
        task = self.data.task
        found = ensemble_refits.held_out(task, replace(fits, spread=base.spread), self.folds)
        if not self.single:
            return found.squares
        plain = replace(fits, scatter=self.plain_scatter)
        return ensemble_refits.held_out(task, plain, self.folds).penalised

    def _unexplained(self, plain, base, before, after, named, scale) -> Location | None:
        """Where the misfit sits if the causes do not explain it: too much is left of it, or one
        component that may bend freely explains it better than all of them."""
        task = self.data.task
        # As a share of the misfit only where it stands out of chi-square's own scatter.
        misfit = after.p_value is not None and after.p_value < SIGNIFICANT
        misfit &= after.excess > _STANDS_OUT * np.sqrt(2 * after.expected)
        left = np.sqrt(max(after.excess, 0.0) / scale) if misfit else 0.0
        if left < self.share and named < 2:
            return None
        self.tell("looking for the component", 0.92)
        if self.compiling is not None:
            self.compiling.join()
        found = locate(task, plain, self.data.scales, before.excess)
        drop = float(en.criterion(task, plain)[0] - en.criterion(task, base)[0])
        numbers = len(base.extra[0]) - len(plain.extra[0])
        if left > LEFT or found.penalised_drop > drop - numbers * task.price:
            return found
        return None

    def _with_alternatives(self, plain, base, best: Candidate, others) -> tuple[Candidate, ...]:
        """What the search compared a cause with, and what else could stand in its place."""
        there = {c.effect for c in others}
        more = [e for e in self.data.looked_for if e in LOCAL and e not in there]
        return (*others, *alternatives(self.data.task, plain, base, best, more))

    def _alike(self, best: Candidate, others: Sequence[Candidate]) -> tuple[str, ...]:
        return tuple(
            c.effect for c in others
            if c is not best and best.penalised_drop - c.penalised_drop < ALIKE
        )  # fmt: skip

    def _causes(self, plain, base, named, scores) -> tuple[Cause, ...]:
        out = []
        for best, others in named:
            weights = [np.exp(0.5 * (c.penalised_drop - best.penalised_drop)) for c in others]
            total = sum(weights) + np.exp(-0.5 * best.penalised_drop)
            cause = self._cause(plain, best, self._alike(best, others), scores, base)
            out.append(replace(cause, probability=float(1.0 / max(total, 1.0))))
        # Every rig has many small imperfections, which good sensors see: first what counts.
        return tuple(sorted(out, key=lambda cause: -cause.change))

    def _cause(self, plain, candidate: Candidate, alike, scores, base=None) -> Cause:
        """The cause as it is told, its numbers those of the final fit."""
        if self.held_plain is None:
            self.held_plain = self._surprise(plain)
        gain = self.held_plain - self._surprise(candidate.fits)
        score = scores.get(candidate.effect)
        predicted = 0.0 if score is None else score.drop
        at = candidate.fits if base is None else base
        return cause_of(self.data.task, plain, at, candidate, alike, predicted, gain)

    def _not_visible(self, scores: dict[str, Score], seen: set[str]) -> tuple[str, ...]:
        unseen = [e for e, s in scores.items() if s.visible < _VISIBLE and e not in seen]
        return (*self.data.impossible, *unseen)
