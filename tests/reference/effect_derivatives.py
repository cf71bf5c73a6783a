"""Derivatives of the reference itself, by differences extrapolated to no step at all."""

from __future__ import annotations

import numpy as np

from . import effects
from .effect_parameters import INF, LEVEL, MASS, NAMES, K, vector

CLEARANCE = 2e-3  # relative; the longest step
LEVELS = 5  # of Richardson's extrapolation, each with half the step of the one before
ENOUGH = 1e-11  # error of a derivative, relative to F_p or d, at which steps need not be shorter
SCALES = {"phase_rad": 1.0, "drift": 1.0, "place": 1.0}  # of a step, where not the value itself


def step_scale(name: str, numbers: np.ndarray) -> float:
    """What the steps in a parameter are relative to."""
    value = numbers[NAMES.index(name)]
    if value == 0:  # k_v or b
        return float(np.sqrt(numbers[K] * numbers[MASS])) / 10
    return max(abs(value), SCALES.get(name.split(".")[-1], 0.0))


def answer(numbers: np.ndarray):
    """F_p, d, the counts, and whether the sensor is saturated."""
    force, distance, counts = effects.answer(numbers)
    return force, distance, counts, force >= numbers[LEVEL]


def course(answered) -> tuple:
    """What has to stay as it is for the answers to be smooth."""
    return effects.signature(answered[2], answered[3])


def derivative(numbers: np.ndarray, name: str, scale: float, middle):
    """d/d(name) of F_p and d, and their errors; None where the course of events changes.

    Richardson's table of central differences; of its entries the one that differs least from
    its neighbours.
    """
    i, watched = NAMES.index(name), course(middle)
    table, best, wrong = [], np.zeros(2), np.full(2, INF)
    for level in range(LEVELS):
        h, sides = CLEARANCE * scale / 2**level, []
        for side in (1, -1):
            moved = numbers.copy()
            moved[i] += side * h
            there = answer(moved)
            if course(there) != watched:
                return None
            sides.append((moved[i], np.array(there[:2])))
        row = [(sides[0][1] - sides[1][1]) / (sides[0][0] - sides[1][0])]
        for n, coarser in enumerate(table[-1] if table else [], start=1):
            row.append(row[-1] + (row[-1] - coarser) / (4**n - 1))
            error = np.maximum(abs(row[-1] - row[-2]), abs(row[-1] - coarser))
            better = error < wrong
            best, wrong = np.where(better, row[-1], best), np.where(better, error, wrong)
        table.append(row)
        if level > 2 and np.all(~(wrong * scale > ENOUGH * abs(np.array(middle[:2])))):
            break
    return best, wrong


def derivatives(rig: dict, names) -> tuple[dict, dict]:
    """name -> d(F_p, d)/d(name), and likewise how far they may be off."""
    numbers = vector(rig)
    middle = answer(numbers)
    slopes, errors = {}, {}
    for name in names:
        found = derivative(numbers, name, step_scale(name, numbers), middle)
        if found is None:
            raise ArithmeticError(f"the course of events changes near this {name}")
        slopes[name], errors[name] = found
    return slopes, errors
