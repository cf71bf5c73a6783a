"""Whether the ways to mu_s of a push agree, and what is taken where they do not.

A whole recording that the model does not follow says little of mu_s, however many samples it has:
its standard error, from their noise alone, is widened by the root of its reduced chi-square, as if
all samples were that much noisier. What it was led astray by may be the same in all of them, so its
mu_s is the push's only where force, distance and slide give none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from difffric.identification.estimates import MISFIT, NONE, Estimate, PushFriction
from difffric.number_text import format_number

APART = 3.0
"""Standard deviations of a difference from which on two ways to mu_s do not agree."""


def judge_recording(push: PushFriction, own_error: float) -> PushFriction:
    """The push with its whole recording's estimate held against how well it fits, and against what
    force and distance, or else the slide, say.

    `own_error` is the estimate's standard error from the noise of the samples alone.
    """
    chi2, trace = push.trace_reduced_chi2, push.mu_s_trace
    if trace.value is None:
        return push
    if chi2 is not None and chi2 > MISFIT:
        trace = _widen(trace, own_error, chi2)
        push = replace(push, mu_s_trace=trace)
        words = (
            "is passed over"
            if push.best_way != "mu_s_trace"
            else f"has its error widened {format_number(chi2**0.5, 2)} times"
        )
        said = f"the whole recording does not fit (chi-square {format_number(chi2, 3)}) and {words}"
        push = replace(push, reason="; ".join(x for x in (push.reason, said) if x))
    other = next((x for x in (push.mu_s_optimal, push.mu_s_slide) if x.value is not None), NONE)
    return replace(push, trace_disagreement=_measure_difference(trace, other))


def _widen(one: Estimate, own_error: float, chi2: float) -> Estimate:
    """The estimate with the noise's part of its error widened; the calibration's stays."""
    shared = float(np.linalg.norm(one.shared))
    return replace(one, standard_error=float(np.hypot(own_error * chi2**0.5, shared)))


def _measure_difference(a: Estimate, b: Estimate) -> float | None:
    """a less b in standard deviations of that difference; None: one is missing, or its error.

    What they share of the calibration counts once. That the samples of one are among the other's
    is left out: it makes the difference's error too large, if anything.
    """
    if a.value is None or b.value is None or a.standard_error is None or b.standard_error is None:
        return None
    if len(a.shared) != len(b.shared):
        return None
    shared = np.array([a.shared, b.shared])
    own = a.standard_error**2 + b.standard_error**2 - float(np.sum(shared**2))
    spread = np.sqrt(max(own, 0.0) + float(np.sum((shared[0] - shared[1]) ** 2)))
    return float((a.value - b.value) / spread) if spread > 0 else None


def describe_agreement(pushes: Sequence[PushFriction]) -> tuple[str, ...]:
    """What a reader should know of how the ways to mu_s agree, a note each."""
    return tuple(
        note
        for note in (
            _describe_misfits(pushes),
            _describe_apart(
                pushes,
                "force and distance",
                lambda p: (p.disagreement, p.mu_s_force, p.mu_s_distance),
            ),
            _describe_apart(
                pushes,
                "the whole recording and the peak force with the distance",
                lambda p: (p.trace_disagreement, p.mu_s_trace, p.mu_s_optimal),
            ),
        )
        if note
    )


def _describe_misfits(pushes: Sequence[PushFriction]) -> str | None:
    """How many whole recordings do not fit, and how badly the worst."""
    bad = [i for i, p in enumerate(pushes) if p.misfits]
    if not bad:
        return None
    worst = max(bad, key=lambda i: pushes[i].trace_reduced_chi2 or 0.0)
    kept = sum(pushes[i].best_way == "mu_s_trace" for i in bad)
    taken = "their mu_s is taken from force and distance"
    if kept:
        taken += f"; {kept} without these are kept with a wider error"
    return (
        f"{len(bad)} of {len(pushes)} whole recordings do not fit the model (chi-square up to "
        f"{format_number(pushes[worst].trace_reduced_chi2, 3)}, {_name(pushes, worst)}; 1 is to "
        f"the noise): {taken}"
    )


def _describe_apart(
    pushes: Sequence[PushFriction],
    ways: str,
    read: Callable[[PushFriction], tuple[float | None, Estimate, Estimate]],
) -> str | None:
    """In how many pushes two ways differ by more than their errors, and by how much at most."""
    found = []
    for i, push in enumerate(pushes):
        apart, a, b = read(push)
        if apart is not None and abs(apart) > APART and a.value is not None and b.value is not None:
            found.append((abs(a.value / b.value - 1), i, a.value, b.value))
    if not found:
        return None
    share, i, a, b = max(found)
    return (
        f"in {len(found)} of {len(pushes)} pushes {ways} differ by more than three standard "
        f"errors, by up to {format_number(100 * share, 3)} % ({_name(pushes, i)}: "
        f"{format_number(a, 4)} against {format_number(b, 4)}): the model or the set-up may be "
        "wrong for these data, or another of several mu_s is the right one"
    )


def _name(pushes: Sequence[PushFriction], i: int) -> str:
    return pushes[i].name or f"push {i + 1}"
