"""Find what an axis does beyond the plain equation: look, fit, add, judge on what was held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from difffric.axis.diagnosis.held_out import judge_held_out
from difffric.axis.diagnosis.screening import Promise, screen_effects
from difffric.axis.diagnosis.verdict import (
    ADEQUATE,
    AMBIGUOUS,
    NAMED,
    UNEXPLAINED,
    AxisCause,
    AxisDiagnosis,
    AxisGain,
    AxisRemainder,
)
from difffric.axis.effects import EFFECTS, list_effect_keys
from difffric.axis.fit import choose_free, conclude_fit, hold_in_bounds
from difffric.axis.identifiability import find_open
from difffric.axis.one_thread import hold_one_thread
from difffric.axis.preparation import PreparedRecording, keep_sliding, prepare_recording
from difffric.axis.recordings import AxisRecordings
from difffric.axis.result import AxisFit
from difffric.axis.search import SearchEnd, find_start, pose_step, search
from difffric.axis.setup import BREAKAWAY, COULOMB, MASS, VISCOUS, AxisSetup
from difffric.progress import Tell, silent

MATTERS = 0.005
"""Share of Coulomb friction from which on an effect matters."""
_CHANCE = 1e-4
"""Probability by chance below which an effect counts as seen, all looks counted."""
_MOST_CAUSES = 4
"""Effects that are added at most."""
_OF_SPEED = {"stribeck", "friction_strengthening", "quadratic_drag", "friction_direction"}
"""Effects that only moves at several speeds show."""
_SHARE_LEFT = 0.5
"""Of the force that is left over, what an effect must add where the motion is imposed: there
nothing tells a small effect from how the force builds up in each move."""
_DETERMINED = 3.0
"""Standard errors that an effect's size must differ from its null by."""
_TRIED = 4
"""Effects that are fitted in full in each round: those that promise most."""
_AS_GOOD = 10.0
"""Difference of the information criterion up to which another effect is as good."""


@dataclass(frozen=True)
class _Tried:
    """An effect fitted in full."""

    promise: Promise
    end: SearchEnd
    drop: float
    """of -2 log likelihood"""
    p_value: float
    worth: float
    """the drop less what so many parameters and looks cost"""
    rivals: tuple[_Tried, ...] = ()
    """what else was tried in its place"""


def diagnose_axis(
    setup: AxisSetup,
    data: AxisRecordings,
    *,
    matters: float = MATTERS,
    tell: Tell = silent,
) -> AxisDiagnosis:
    """Say what the axis does beyond its set-up, and extend it by that.

    `matters` is the share of Coulomb friction below which an effect is negligible.

    Raises `InputError` where the data cannot be used.
    """
    tell("cutting the recording", 0.02)
    ready = prepare_recording(data, setup)
    names = choose_free(setup, None)
    names += [x for e in setup.effects for x in list_effect_keys(e) if _is_free(setup, x)]
    names = [*dict.fromkeys(names)]
    with hold_one_thread():
        start, imposed = find_start(ready.run_data, setup.values, names)
        ready = keep_sliding(ready) if imposed else ready
        held, left_open = find_open(ready, setup, names, imposed)
        names = [x for x in names if x not in held]
        start = start | {x: setup.values[x] for x in held}
        tell("fitting", 0.1)
        plain = search(ready.run_data, start, names, imposed)
        plain, bounded = hold_in_bounds(ready, plain, setup)
        found, whole = _add_causes(ready, setup, plain, tell)
        found, small, end = _part_by_size(ready, found, plain, whole, matters)
        tell("judging on stretches held out", 0.8)
        gain = AxisGain(
            judge_held_out(ready, plain.values, plain.names, imposed, end.noise.sizes, plain.model),
            judge_held_out(ready, end.values, end.names, imposed, end.noise.sizes, end.model),
        )
        before = conclude_fit(setup, ready, plain, left_open, bounded)
        after = conclude_fit(setup, ready, end, left_open, bounded) if found else before
        # What is seen and too small to matter is not left over: it is known what it is.
        left = conclude_fit(setup, ready, whole, left_open) if small else after
        remaining = _find_remainder(ready, whole, left, matters)
    causes = tuple(_describe(ready, one, end) for one in found)
    verdict = _choose_verdict(causes, remaining)
    return AxisDiagnosis(
        verdict=verdict,
        causes=causes,
        negligible=tuple(_describe(ready, one, one.end) for one in small),
        gain=gain,
        remaining=remaining,
        lack_of_fit=_test_plain(before, found),
        not_visible=_list_invisible(ready, setup),
        next_experiment=_propose(causes, verdict, ready),
        plain=before,
        fit=after,
    )


def _is_free(setup: AxisSetup, name: str) -> bool:
    said = setup.extras.get(name)
    return said is not None and bool(said.free)


def _add_causes(
    ready: PreparedRecording, setup: AxisSetup, plain: SearchEnd, tell: Tell
) -> tuple[list[_Tried], SearchEnd]:
    """The effects that are seen, in the order in which they were added, and the fit with them."""
    end, found = plain, []
    for k in range(_MOST_CAUSES):
        tell("looking for effects", 0.15 + 0.15 * k)
        there = {*setup.effects, *(one.promise.effect for one in found)}
        if plain.imposed and VISCOUS not in plain.names:
            there |= _OF_SPEED  # each way has one speed, and what differs is when and where
        tried = _try_effects(ready, end, [x for x in EFFECTS if x not in there])
        seen = sorted((x for x in tried if x.p_value < _CHANCE), key=lambda x: -x.worth)
        best = next((x for x in seen if _does_hold(ready, end, x)), None)
        if best is None:
            break
        found.append(replace(best, rivals=tuple(x for x in tried if x is not best)))
        end = best.end
    return _drop_idle(ready, plain, found, end)


def _does_hold(ready: PreparedRecording, end: SearchEnd, one: _Tried) -> bool:
    """Whether an effect is determined, and predicts stretches that its fit has not seen better
    than the fit without it does."""
    new = one.end
    errors = np.sqrt(np.maximum(np.diag(new.noise.covariance), 0.0))
    size = next(x for x in one.promise.names if "." in x)
    if abs(new.values[size]) < _DETERMINED * errors[[*new.names].index(size)]:
        return False
    sizes = new.noise.sizes
    if new.imposed:
        left = float(np.sqrt(sizes[:-1].sum()))
        if _measure_change(ready, one, new)[0] < _SHARE_LEFT * left:
            return False
    before = judge_held_out(ready, end.values, end.names, end.imposed, sizes, end.model)
    after = judge_held_out(ready, new.values, new.names, new.imposed, sizes, new.model)
    return before is None or after is None or after < before


def _try_effects(
    ready: PreparedRecording, end: SearchEnd, candidates: Sequence[str]
) -> list[_Tried]:
    """The most promising effects, fitted in full."""
    promises = screen_effects(ready, end, candidates)
    promises = sorted(promises, key=lambda x: -_measure_worth(x.drop, x, end))[:_TRIED]
    tried = []
    for promise in promises:
        if _find_chance(promise.drop, promise) > 0.05:
            continue
        one = _fit_with(ready, end, promise)
        if one is not None:
            tried.append(one)
    return tried


def _fit_with(ready: PreparedRecording, end: SearchEnd, promise: Promise) -> _Tried | None:
    """The fit with an effect, or None where it fails or ends at the null or a wrong sign."""
    values = end.values | promise.start
    names = [*end.names, *(x for x in promise.names if x not in end.names)]
    try:
        new = search(ready.run_data, values, names, end.imposed, end.noise.sizes, model=end.model)
    except np.linalg.LinAlgError:
        return None
    if promise.effect == "stribeck" and new.values[BREAKAWAY] <= new.values[COULOMB]:
        return None
    if promise.effect == "friction_strengthening" and new.values[promise.names[0]] <= 0:
        return None
    drop = end.log_likelihood - new.log_likelihood
    p_value = _find_chance(drop, promise)
    return _Tried(promise, new, drop, p_value, _measure_worth(drop, promise, end))


def _find_chance(drop: float, promise: Promise) -> float:
    """The probability of so large a drop by chance, with all looks and all effects counted."""
    one = float(scipy.stats.chi2.sf(max(drop, 0.0), _count_linear(promise)))
    return min(1.0, one * promise.looks * len(EFFECTS))


def _count_linear(promise: Promise) -> int:
    """Parameters less those of the grid, whose looks are counted instead."""
    grid = sum(
        key.is_scanned
        for key, name in zip(
            EFFECTS[promise.effect].keys, list_effect_keys(promise.effect), strict=True
        )
        if name in promise.names
    )
    return max(len(promise.names) - grid, 1)


def _measure_worth(drop: float, promise: Promise, end: SearchEnd) -> float:
    """A drop less its cost by the Bayesian information criterion."""
    return drop - len(promise.names) * np.log(end.problem.n)


def _drop_idle(
    ready: PreparedRecording, plain: SearchEnd, found: list[_Tried], end: SearchEnd
) -> tuple[list[_Tried], SearchEnd]:
    """Without the effects that later ones made idle."""
    for one in list(found[:-1]):
        rest = [x for x in found if x is not one]
        without = _refit(ready, plain, rest, end)
        drop = without.log_likelihood - end.log_likelihood
        if _find_chance(drop, one.promise) > _CHANCE:
            found, end = rest, without
    return found, end


def _refit(
    ready: PreparedRecording, plain: SearchEnd, found: Sequence[_Tried], end: SearchEnd
) -> SearchEnd:
    """The fit with some of the effects that another fit has."""
    kept = {name for one in found for name in one.promise.names}
    effects = {one.promise.effect for one in found}
    values = {k: v for k, v in end.values.items() if "." not in k or k.partition(".")[0] in effects}
    values |= {k: v for k, v in plain.values.items() if k not in values}
    if BREAKAWAY not in kept:
        values[BREAKAWAY] = plain.values[BREAKAWAY]
    names = [*plain.names, *(x for x in end.names if x in kept and x not in plain.names)]
    return search(ready.run_data, values, names, end.imposed, end.noise.sizes, model=end.model)


def _part_by_size(
    ready: PreparedRecording,
    found: list[_Tried],
    plain: SearchEnd,
    end: SearchEnd,
    matters: float,
) -> tuple[list[_Tried], list[_Tried], SearchEnd]:
    """Effects that matter, those that do not, and the fit with the former."""
    small = [x for x in found if _measure_change(ready, x, end)[1] < matters]
    if small:
        found = [x for x in found if x not in small]
        end = _refit(ready, plain, found, end) if found else plain
    return found, small, end


def _measure_change(ready: PreparedRecording, one: _Tried, end: SearchEnd) -> tuple[float, float]:
    """(force that an effect adds beside what plain friction could take over [N], rms; that as a
    share of Coulomb friction)."""
    effect, v = one.promise.effect, end.values if one.promise.names[0] in end.values else None
    v = one.end.values if v is None else v
    if EFFECTS[effect].delays:
        delay = v[one.promise.names[0]]
        moved = [(_differ(r.force, r.tau) * delay)[:: r.per_block] for r in ready.run_data]
        force = float(np.sqrt(np.mean(np.concatenate(moved) ** 2)))
    else:
        sizes = [v[key] for key in list_effect_keys(effect)]
        parts, plain_columns = [], []
        for run in ready.run_data:
            some = slice(None, None, run.per_block)
            law = EFFECTS[effect].law.resist(run.point, v, *sizes)
            parts.append(np.broadcast_to(law, run.tau.shape)[some])
            u, a = run.point.speed[some], run.acceleration[some]
            plain_columns.append(np.column_stack([np.ones(len(u)), np.sign(u), u, a]))
        y, X = np.concatenate(parts), np.concatenate(plain_columns)
        scale = np.linalg.norm(X, axis=0) + 1e-300
        left = y - X @ (np.linalg.lstsq(X / scale, y, rcond=1e-9)[0] / scale)
        force = float(np.sqrt(np.mean(left**2)))
    coulomb = end.values[COULOMB]
    return force, force / coulomb


def _differ(force: NDArray, tau: NDArray) -> NDArray:
    """The slope of a force over time [N/s]."""
    return np.gradient(force, tau)


def _describe(ready: PreparedRecording, one: _Tried, end: SearchEnd) -> AxisCause:
    """An effect as a person reads it, with the numbers of the final fit."""
    effect = EFFECTS[one.promise.effect]
    errors = dict(
        zip(end.names, np.sqrt(np.maximum(np.diag(end.noise.covariance), 0.0)), strict=True)
    )
    parameters: dict[str, tuple[float, float]] = {
        name.partition(".")[2] or name: (float(end.values[name]), float(errors[name]))
        for name in one.promise.names
        if name in errors
    }
    force, change = _measure_change(ready, one, end)
    rivals = [x for x in one.rivals if x.promise.effect != effect.id]
    confusable = tuple(
        x.promise.effect for x in rivals if one.worth - x.worth < _AS_GOOD and x.p_value < _CHANCE
    )
    worths = np.array([one.worth, *(x.worth for x in rivals)])
    shares = np.exp((worths - worths.max()) / 2)
    return AxisCause(
        effect.id,
        effect.component,
        effect.text,
        parameters,
        one.drop,
        one.promise.drop,
        one.p_value,
        float(shares[0] / shares.sum()),
        confusable,
        force,
        change,
    )


def _choose_verdict(causes: Sequence[AxisCause], remaining: AxisRemainder | None) -> str:
    if causes:
        return AMBIGUOUS if causes[0].confusable_with else NAMED
    return UNEXPLAINED if remaining is not None else ADEQUATE


def _test_plain(before: AxisFit, found: Sequence[_Tried]) -> float:
    """The p-value of the plain axis: of the forces that nothing explains, or of the first cause."""
    by_force = before.noise.force_p_value
    by_cause = found[0].p_value if found else 1.0
    return min(1.0 if by_force is None else by_force, by_cause)


def _find_remainder(
    ready: PreparedRecording, end: SearchEnd, after: AxisFit, matters: float
) -> AxisRemainder | None:
    """What is left over where it is beyond chance and large enough to matter."""
    noise = after.noise
    share = noise.force / end.values[COULOMB]
    p_value = noise.force_p_value
    if end.imposed:
        p_value = 0.0
    if p_value is None or p_value > _CHANCE or share < matters:
        return None
    return AxisRemainder(noise.force, p_value, share, _locate(ready, end))


def _locate(ready: PreparedRecording, end: SearchEnd) -> str:
    """`friction` where what is left turns with the direction, `pusher` where it does not: by free
    curves over position and over speed."""
    model = end.model
    problem = pose_step(model, model.evaluate(end.values, end.names), end.values, end.names)
    scale = 1.0 if end.imposed else 1.0 / end.values[MASS]
    place = np.concatenate([r.point.position for r in ready.run_data])
    edges = np.quantile(place, np.linspace(0, 1, 9)[1:-1])
    drops = []
    for odd in (True, False):
        extra = []
        for k, run in enumerate(ready.run_data):
            at = np.digitize(run.point.position, edges)
            factor = run.run.sign if odd else 1.0
            curves = [model.respond_to(k, factor * (at == j).astype(float)) for j in range(7)]
            extra.append(scale * np.column_stack(curves))
        drops.append(float(problem.screen(end.noise.sizes, extra, 7)[0]))
    return "friction" if drops[0] >= drops[1] else "pusher"


def _list_invisible(ready: PreparedRecording, setup: AxisSetup) -> tuple[str, ...]:
    """Effects that no such data could show."""
    hidden = ["friction_direction.coulomb_share", "tilt", "presliding"]
    if len(ready.data) < 3:
        hidden.append("friction_drift")
    return tuple(hidden)


def _propose(causes: Sequence[AxisCause], verdict: str, ready: PreparedRecording) -> str | None:
    """What would tell more."""
    if verdict == AMBIGUOUS:
        pair = {causes[0].id, *causes[0].confusable_with}
        usual = ready.usual_speed
        if pair <= {"stribeck", "friction_strengthening", "quadratic_drag", "friction_direction"}:
            return f"moves at {usual / 20:.2g} m/s and at {2 * usual:.2g} m/s, both ways"
        return f"longer moves at a slow constant speed ({usual / 5:.2g} m/s), both ways"
    if verdict == UNEXPLAINED:
        return "the same moves again: what repeats is the axis, what does not is a disturbance"
    return None
