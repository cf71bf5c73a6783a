"""Steps of Dormand and Prince's method of order 8, and roots found by stepping anew."""

from __future__ import annotations

import numpy as np
from scipy.integrate import DOP853

from .effect_laws import F, L, Q, U, V, X, Z, rates
from .effect_parameters import F_SCALE, KINETIC, LOAD, SIGMA_0, SPEED, Z_SCALE
from .jit import COMPILED, jit, law

STAGES = 12
NODES = np.array(DOP853.C[:STAGES])
WEIGHTS = np.array(DOP853.A[:STAGES, :STAGES])
LAST = np.array(DOP853.B)
ERROR_3, ERROR_5 = np.array(DOP853.E3[:STAGES]), np.array(DOP853.E5[:STAGES])
TOLERANCE = 1e-16
WIDTH = 2.5e-16  # relative, of a bracket that is narrow enough


@jit
def scales(p):
    """What the error of each part of the state is measured in."""
    scale = np.ones(7)
    scale[Z] = scale[X] = p[Z_SCALE]
    scale[U] = scale[V] = p[SPEED]
    scale[F] = scale[L] = p[F_SCALE]
    if p[SIGMA_0] > 0:
        scale[Q] = p[KINETIC] * p[LOAD] / p[SIGMA_0]
    return scale


@law
def advance_compiled(t, s, h, p, mode, stages, out):
    """s(t + h) into `out`, where stages[0] holds the rates at t."""
    for i in range(1, STAGES):
        for j in range(s.size):
            total = 0.0
            for n in range(i):
                total += WEIGHTS[i, n] * stages[n, j]
            out[j] = s[j] + h * total
        rates(t + NODES[i] * h, out, p, mode, stages[i])
    for j in range(s.size):
        total = 0.0
        for n in range(STAGES):
            total += LAST[n] * stages[n, j]
        out[j] = s[j] + h * total


def advance_plain(t, s, h, p, mode, stages, out):
    """The same in numpy's words, quicker where nothing is compiled."""
    for i in range(1, STAGES):
        out[:] = s + h * (WEIGHTS[i, :i] @ stages[:i])
        rates(t + NODES[i] * h, out, p, mode, stages[i])
    out[:] = s + h * (LAST @ stages)


advance = advance_compiled if COMPILED else advance_plain


@law
def error(s, out, h, scale, stages):
    """The last step's error in units of what is allowed."""
    fifth, third = 0.0, 0.0
    for j in range(s.size):
        allowed = TOLERANCE * (scale[j] + max(abs(s[j]), abs(out[j])))
        five, three = 0.0, 0.0
        for n in range(STAGES):
            five += ERROR_5[n] * stages[n, j]
            three += ERROR_3[n] * stages[n, j]
        fifth += (five / allowed) ** 2
        third += (three / allowed) ** 2
    if fifth == 0 and third == 0:
        return 0.0
    return abs(h) * fifth / np.sqrt((fifth + 0.01 * third) * s.size)
