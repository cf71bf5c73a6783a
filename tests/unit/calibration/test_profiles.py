"""Error bars from profiles of the likelihood."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from difffric.calibration.optimal_push import next_push
from difffric.calibration.profiles import profile
from difffric.errors import InputError
from difffric.measurements.recordings import Channel, Recording, Recordings
from difffric.rig import parameters
from difffric.rig.setup import Extras
from tests.reference import data as reference
from tests.unit.calibration.designs import CALIBRATED, TRUTH, calibrate, make_setup


def test_profiles_are_gaussian_where_the_model_is_linear(exact):
    *_, fit = exact
    for found in profile(fit).values():
        assert found.note is None
        for level, ends in found.intervals.items():
            gauss = found.gaussian[level]
            assert ends == pytest.approx(gauss, abs=0.01 * (gauss[1] - gauss[0]))
        assert found.asymmetry == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("label", ["b_N_s_per_m", "k_N_per_m"])
def test_at_a_profiles_end_a_fit_of_the_others_is_worse_by_the_squared_quantile(
    coarse, label, side
):
    known, pushes, fit = coarse
    end = profile(fit, [label], levels=[0.95])[label].intervals[0.95][side]
    rig = parameters.with_values(known.rig, {**_values(fit), label: end})
    others = [x for x in CALIBRATED if x != label]
    there = calibrate(replace(known, rig=rig), pushes, free=others)
    assert np.isinf(fit.freedom).all()  # all variances are known
    assert there.chi2 - fit.chi2 == pytest.approx(1.959964**2, rel=0.02)


def _values(fit):
    return {label: fit.value(label) for label in fit.free}


def test_a_profile_rises_from_the_fit_and_wider_levels_contain_narrower_ones(coarse):
    *_, fit = coarse
    for found in profile(fit).values():
        value, rise = found.curve.T
        left, right = rise[value <= found.value], rise[value >= found.value]
        assert (np.diff(left) <= 1e-6).all() and (np.diff(right) >= -1e-6).all()
        assert rise.min() == pytest.approx(0.0, abs=1e-9)
        lows, highs = zip(*found.intervals.values(), strict=True)
        lows = [-np.inf if x is None else x for x in lows]
        highs = [np.inf if x is None else x for x in highs]
        assert sorted(lows, reverse=True) == lows and sorted(highs) == highs


def test_a_damping_that_the_bound_stops_has_an_open_side_that_says_so(coarse):
    known, pushes, _ = coarse
    bounded = replace(known, extras={**known.extras, "b_N_s_per_m": Extras(lower=TRUTH.b * 0.995)})
    fit = calibrate(bounded, pushes)
    found = profile(fit, ["b_N_s_per_m"])["b_N_s_per_m"]
    assert found.intervals[0.997][0] is None
    assert "bound" in found.reasons[0]
    assert found.reasons[1] is None


@pytest.mark.slow
def test_from_recordings_profiles_are_gaussian_too_and_a_push_is_foreseen():
    rng = np.random.default_rng(4)
    made = reference.make_pushes(TRUTH, rng, 10)
    more = reference.make_pushes(TRUTH, rng, 1, speeds=[0.06])

    def recordings(pushes):
        taken = [reference.record(p, rng) for p in pushes]
        return Recordings(
            tuple(
                Recording(
                    velocity=x.push.velocity,
                    force=Channel.of(x.force, x.dt, x.start, "N"),
                    position=Channel.of(x.position, x.dt, x.start, "m"),
                    stroke=x.push.stroke,
                    mass=np.nan,
                )
                for x in taken
            )
        )

    known, first = make_setup(TRUTH, TRUTH.scatter), recordings(made)
    fit = calibrate(known, first)
    for found in profile(fit, levels=[0.95]).values():
        low, high = found.gaussian[0.95]
        assert found.intervals[0.95] == pytest.approx((low, high), abs=0.03 * (high - low))
    push = next_push(fit, speeds=[0.06])
    again = calibrate(known, Recordings((*first, *recordings(more))))
    for label in CALIBRATED:
        assert again.standard_error(label) == pytest.approx(push.after[label], rel=0.05)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda fit: profile(fit, ["mass_kg"]), "not free in this fit: mass_kg"),
        (lambda fit: profile(fit, levels=[95]), "expected numbers between 0 and 1"),
    ],
)
def test_bad_input_is_one_clear_line(coarse, call, message):
    with pytest.raises(InputError, match=message) as error:
        call(coarse[2])
    assert "\n" not in str(error.value)
