"""A watched machine: no alarm while nothing changes, one when something does, and what changed.

Pushes come from the tests' own simulator; the set-up of the monitor is wrong on purpose where a
test is about that.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import difffric as df
from difffric.errors import InputError
from difffric.monitoring import shiryaev_roberts
from difffric.monitoring.alarms import Alarm
from difffric.monitoring.baseline import Baseline, Spread
from difffric.monitoring.change_cause import conclude
from difffric.monitoring.change_point import find_change
from difffric.monitoring.local_level import Level
from difffric.monitoring.monitor import Monitor
from difffric.monitoring.readings import Reader
from difffric.rig.setup import Setup
from tests.reference.data import MM_MIN, Rig, make_pushes, measure

TRUE = Rig(m=18.9, mu_s=0.141, ratio=0.75, k_v=5.0, k=8e5, b=1500.0, scatter=0.015, stroke=1.2e-3)
SPEEDS = tuple(MM_MIN * v for v in (2000, 3000, 5000))


def setup(rig=TRUE, scatter: float | None = 0.015) -> Setup:
    """What the monitor is told of a rig."""
    return Setup(
        df.spring_damper_rig(
            mass=rig.m, mu_s=rig.mu_s, k=rig.k, b=rig.b, k_v=rig.k_v, mu_k_over_mu_s=rig.ratio,
            stroke=rig.stroke,
        ),
        scatter,
    )  # fmt: skip


def table(*stages: tuple[Rig, int], seed: int, speeds=SPEEDS, condition="A") -> dict:
    """Measured pushes: so many of each rig, one after the other."""
    rng, pushes = np.random.default_rng(seed), []
    for rig, n in stages:
        first = len(pushes) + 1
        pushes += make_pushes(rig, rng, n, speeds, condition=condition, first=first)
    return measure(pushes, rng)


def fed(monitor: Monitor, columns: dict, first: int = 0, last: int | None = None):
    """The monitor after these pushes."""
    for i in range(first, len(columns["order"]) if last is None else last):
        row = {k: float(v[i]) for k, v in columns.items() if k != "condition"}
        monitor.update(**row, condition=str(columns["condition"][i]))
    return monitor


def run_lengths(arl, shift, n=400, steps=600, seed=0):
    """Pushes to the first alarm after a shift of z, (n,); those without any are left out."""
    rng, log_R = np.random.default_rng(seed), np.repeat(shiryaev_roberts.start()[None], n, axis=0)
    found = np.full(n, np.nan)
    for i in range(1, steps + 1):
        log_R = shiryaev_roberts.update(log_R, rng.standard_normal((n, 2)) + np.array(shift))
        new = np.isnan(found) & (
            shiryaev_roberts.total(log_R) >= shiryaev_roberts.log_threshold(arl)
        )
        found[new] = i
    return found


# The charts.


@pytest.mark.parametrize("arl", [50.0, 200.0])
def test_false_alarms_come_as_seldom_as_stated(arl):
    rng, n = np.random.default_rng(3), 500
    log_R, alarms, steps = np.repeat(shiryaev_roberts.start()[None], n, axis=0), 0, round(8 * arl)
    for _ in range(steps):
        log_R = shiryaev_roberts.update(log_R, rng.standard_normal((n, 2)))
        over = shiryaev_roberts.total(log_R) >= shiryaev_roberts.log_threshold(arl)
        alarms += over.sum()
        log_R[over] = -np.inf
    # The first run of each has its whole length ahead: that is 1/16 of all here.
    assert n * steps / alarms == pytest.approx(arl, rel=0.15)


def test_the_statistic_grows_by_one_a_push_in_expectation():
    """What the bound on the run length rests on: R_n - n is a martingale."""
    rng, n = np.random.default_rng(4), 200_000
    log_R = np.repeat(shiryaev_roberts.start()[None], n, axis=0)
    for i in range(1, 4):
        log_R = shiryaev_roberts.update(log_R, rng.standard_normal((n, 2)))
        R = np.exp(shiryaev_roberts.total(log_R))
        assert abs(R.mean() - i) < 5 * R.std() / np.sqrt(n)


@pytest.mark.parametrize("delta", [0.5, 1.0, 2.0])
def test_the_overshoot_is_that_of_a_random_walk(delta):
    """lim E exp(-overshoot), against walks that are followed over a far threshold."""
    rng, n, far = np.random.default_rng(5), 20_000, 12.0
    walk, over = np.zeros(n), np.full(n, np.nan)
    while np.isnan(over).any():
        walk += delta * (rng.standard_normal(n) + delta) - 0.5 * delta**2
        new = np.isnan(over) & (walk >= far)
        over[new] = walk[new] - far
    seen = np.exp(-over)
    assert abs(seen.mean() - shiryaev_roberts.overshoot(delta)) < 4 * seen.std() / np.sqrt(n)


def test_both_signs_and_both_channels_are_watched():
    for shift in ((2, 0), (-2, 0), (0, 2), (0, -2)):
        assert np.nanmedian(run_lengths(1000, shift, steps=60)) <= 8


def test_one_wild_push_alone_is_no_alarm():
    log_R = shiryaev_roberts.start()
    log_R = shiryaev_roberts.update(log_R, np.array([1e3, 0.0]))
    assert shiryaev_roberts.total(log_R) < shiryaev_roberts.log_threshold(1000)
    log_R = shiryaev_roberts.update(log_R, np.array([1e3, 0.0]))
    assert shiryaev_roberts.total(log_R) >= shiryaev_roberts.log_threshold(1000)


@pytest.mark.parametrize("prior", [0.0, 3.0])
def test_judged_numbers_are_standard_normal_and_independent(prior):
    """Self-starting, from the second of each cell on, whatever the means are."""
    rng, z, after = np.random.default_rng(6), [], []
    for _ in range(400):
        cells, previous = Baseline(Spread.from_prior(1.0, prior)), None
        means = rng.uniform(-50, 50, 3)
        for i in range(30):
            k = i % 3
            h = rng.uniform(0.5, 2.0)
            found = cells.judge(means[k] + np.sqrt(h) * rng.standard_normal(), h, str(k))
            if found.z is None:
                continue
            # With a prior that is right the first are wider than normal allows, not narrower.
            if prior == 0 or i > 20:
                z.append(found.z)
                if previous is not None:
                    after.append(previous * found.z)
            previous = found.z
    assert stats.kstest(z, "norm").pvalue > (1e-3 if prior == 0 else 1e-6)
    assert abs(np.mean(after)) < 4 / np.sqrt(len(after))


def test_a_mean_without_some_numbers_is_that_of_the_others():
    rng = np.random.default_rng(7)
    cells = Baseline(Spread.from_prior(1.0, 3.0))
    y, h = 5 + rng.standard_normal(12), rng.uniform(0.5, 2, 12)
    for a, b in zip(y, h, strict=True):
        cells.judge(a, b, "a")
    left = cells.get_mean("a").remove(list(zip(y[7:], h[7:], strict=True)))
    assert left.value == pytest.approx(np.average(y[:7], weights=1 / h[:7]))
    assert left.weight == pytest.approx((1 / h[:7]).sum())


def test_the_change_point_is_where_the_change_is():
    rng = np.random.default_rng(8)
    z = rng.standard_normal((60, 2))
    z[40:, 0] += 4
    found = find_change(z)
    assert found.kind == "step" and abs(found.step - 40) <= 1
    z = rng.standard_normal((60, 2))
    z[20:, 1] += 0.15 * np.arange(40)
    found = find_change(z)
    assert found.kind == "drift" and abs(found.ramp - 20) <= 10


def test_the_level_forgets_the_speed():
    """The same friction at speeds that read differently is one level; its error is honest."""
    rng, inside = np.random.default_rng(9), []
    for _ in range(200):
        level, x, offsets = Level(), rng.uniform(-3, -1), (0.0, 0.08, -0.05)
        for i in range(40):
            k = i % 3
            level.see(str(k), x + offsets[k] + 0.015 * rng.standard_normal(), 0.015**2, 0.0015**2)
        value, error = level.log_mu_s
        inside.append(abs(value - x) < 2 * error)
    assert 0.92 <= np.mean(inside) <= 1.0  # x does not wander here, though the filter lets it


# A push.


def test_a_reading_is_mu_s_and_what_it_cannot_explain():
    """Over the sensors' noise both are normal with the stated errors, and independent."""
    columns = table((replace(TRUE, scatter=0.05), 200), seed=11)
    rng = np.random.default_rng(11)
    own = np.concatenate(
        [[p.mu_s for p in make_pushes(replace(TRUE, scatter=0.05), rng, 200, SPEEDS)]]
    )
    read = Reader(setup().rig).read(df.Pushes(**columns))
    assert read.reason == [None] * 200
    off = (read.log_mu_s - np.log(own)) / read.error
    for numbers in (off, read.contrast):
        assert stats.kstest(numbers, "norm").pvalue > 1e-3
    assert abs(np.corrcoef(off, read.contrast)[0, 1]) < 0.25


def test_a_reading_is_that_of_the_inversion():
    columns = table((TRUE, 12), seed=12)
    pushes = df.Pushes(**columns)
    read = Reader(setup().rig).read(pushes)
    for i, found in enumerate(df.identify(setup().rig, pushes)):
        assert np.exp(read.log_mu_s[i]) == pytest.approx(found.mu_s_optimal.value, rel=2e-4)


def test_what_no_friction_gives_has_a_reason():
    columns = table((TRUE, 3), seed=13)
    columns["sliding_distance"] = columns["sliding_distance"] * 400
    read = Reader(setup().rig).read(df.Pushes(**columns))
    assert all("no mu_s gives d" in str(words) for words in read.reason)


# A machine.


@pytest.mark.parametrize("seed", range(3))
def test_a_step_of_friction_is_found_named_and_measured(seed):
    monitor = fed(
        Monitor(setup()), table((TRUE, 60), (replace(TRUE, mu_s=1.08 * 0.141), 25), seed=seed)
    )
    first = monitor.alarms[0]
    assert 61 <= first.push <= 70 and abs(first.change - 61) <= 3
    assert first.direction == "friction up"
    best = first.causes(monitor.reader)[0]
    assert conclude([best])[0] == best.parameter == "mu_s"
    assert best.standard_error is not None
    assert abs(best.change - 0.08) < 4 * best.standard_error < 0.08


@pytest.mark.parametrize(
    ("name", "factor"),
    [("k_N_per_m", 0.9), ("b_N_s_per_m", 1.2), ("force_gain.factor", 1.05)],
)
def test_what_changed_is_named(name, factor):
    changed = {"k_N_per_m": "k", "b_N_s_per_m": "b"}.get(name)
    after = replace(TRUE, **{changed: factor * getattr(TRUE, changed)}) if changed else TRUE
    columns = table((TRUE, 60), (after, 24), seed=21)
    if not changed:
        columns["peak_force"] = np.where(columns["order"] > 60, factor, 1) * columns["peak_force"]
    monitor = fed(Monitor(setup()), columns)
    first = monitor.alarms[0]
    assert 61 <= first.push <= 65
    found = first.causes(monitor.reader)
    assert conclude(found)[0] == name
    assert found[0].standard_error is not None
    assert abs(found[0].change - (factor - 1)) < 4 * found[0].standard_error


def test_at_one_speed_stiffness_and_gain_cannot_be_told():
    columns = table((TRUE, 60), (TRUE, 8), seed=22, speeds=SPEEDS[1:2])
    columns["peak_force"] = np.where(columns["order"] > 60, 1.02, 1) * columns["peak_force"]
    monitor = fed(Monitor(setup()), columns)
    named, words = conclude(monitor.alarms[0].causes(monitor.reader))
    assert named is None and "stiffness" in words and "gain of the force sensor" in words


def test_neither_a_new_speed_nor_a_new_part_is_an_alarm_where_the_model_is_wrong():
    """A set-up with thrice the viscous friction and another mu_k / mu_s: mu_s then reads otherwise
    at each speed and of each part, by far more than it scatters."""
    wrong = Monitor(setup(replace(TRUE, k_v=15.0, ratio=0.68)), arl=1e5)
    stages = []
    for i, (condition, mu_s, mass, speed) in enumerate(
        [("A", 0.141, 18.9, 5000), ("A", 0.141, 18.9, 2500), ("B", 0.11, 18.9, 3500),
         ("B", 0.11, 12.0, 5000), ("A", 0.141, 18.9, 3500), ("B", 0.11, 18.9, 2500)]
    ):  # fmt: skip
        rig = replace(TRUE, mu_s=mu_s, m=mass)
        columns = table((rig, 25), seed=30 + i, speeds=[MM_MIN * speed], condition=condition)
        stages.append(columns | {"order": columns["order"] + 25 * i})
    for columns in stages:
        fed(wrong, columns)
    assert wrong.identified == 150 and not wrong.alarms
    read = {(c.part, round(c.velocity / MM_MIN)): m.value for (k, m), c in zip(
        wrong.friction.means.items(), wrong.cells.values(), strict=True)}  # fmt: skip
    assert abs(read["1", 5000] - read["1", 2500]) > 0.015  # more than the scatter of one push


def test_the_scatter_may_be_unknown():
    noisy = replace(TRUE, scatter=0.03)
    monitor = fed(Monitor(setup(scatter=None)), table((noisy, 120), seed=41))
    assert not monitor.alarms
    spreads = [monitor.friction.get_spread(k).phi ** 0.5 * monitor.scatter for k in monitor.cells]
    assert np.mean(spreads) == pytest.approx(0.03, rel=0.2)


def test_a_monitor_goes_on_as_if_nothing_had_been_between():
    columns = table((TRUE, 40), (replace(TRUE, mu_s=1.1 * 0.141), 30), seed=51)
    whole = fed(Monitor(setup()), columns)
    for cut in (1, 17, 42, 55):
        first = fed(Monitor(setup()), columns, last=cut)
        saved = json.loads(json.dumps(first.as_dict(), allow_nan=False))
        again = fed(Monitor.read(setup(), saved), columns, first=cut)
        assert json.dumps(again.as_dict()) == json.dumps(whole.as_dict())
    assert len(whole.alarms) == 1


def test_pushes_that_cannot_come_next_are_refused_and_change_nothing():
    columns = table((TRUE, 5), seed=61)
    monitor = fed(Monitor(setup()), columns)
    before = json.dumps(monitor.as_dict())
    with pytest.raises(InputError, match="the same push as number 3"):
        fed(monitor, columns, first=2, last=3)
    with pytest.raises(InputError, match="its order is 4 after 5"):
        monitor.update(0.05, 170.0, 3e-3, order=4.0)
    with pytest.raises(InputError, match="velocity of push 0 is -1"):
        monitor.update(-1.0, 170.0, 3e-3, order=6.0)
    assert json.dumps(monitor.as_dict()) == before


def test_a_push_that_cannot_be_identified_is_counted_and_harmless():
    columns = table((TRUE, 20), seed=62)
    plain = fed(Monitor(setup()), columns)
    monitor = fed(Monitor(setup()), columns, last=10)
    lost = monitor.update(0.05, 175.0, 0.2)
    assert lost.mu_s is None and lost.reason and lost.number == 11
    fed(monitor, columns, first=10)
    assert monitor.count == 21 and monitor.identified == 20
    assert np.array_equal(monitor.log_R, plain.log_R)


def test_arl_below_sense_is_refused():
    with pytest.raises(InputError, match="--arl: expected at least 20 pushes, got 5"):
        Monitor(setup(), arl=5)


def test_an_alarm_stands_in_a_state_file_as_it_always_did():
    """Lists of numbers in a fixed order, null for what was not measured or is not known."""
    one = [0.05, None, None, [0.5, None], -1.9, None, [1e-4, None], [1.0, 0.7], [3.0, 0.0]]
    two = [0.05, 18.9, 1e-3, [0.5, 3e-7], -1.9, 0.2, [1e-4, 0.1], [1.0, 0.7], [3.0, 2.0]]
    saved = {
        "push": 31,
        "change": 25,
        "kind": "step",
        "direction": "friction up",
        "settings": {"1": one, "2": two},
        "after": [["1", -1.8, 2e-4, None], ["2", -1.8, 2e-4, 0.3]],
    }
    alarm = Alarm.read(saved)
    assert alarm.settings["1"].sigma == (0.5, math.inf) and math.isnan(alarm.settings["1"].mass)
    assert alarm.settings["2"].stroke == 1e-3 and alarm.after[1].contrast == 0.3
    assert alarm.as_dict() == saved
