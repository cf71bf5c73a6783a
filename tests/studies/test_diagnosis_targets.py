"""What was asked of diagnoses is judged by intervals, never by a share alone."""

import numpy as np
import pytest

from studies import diagnosis_targets as targets
from studies.diagnosis import GROUPS
from studies.diagnosis_targets import Found, Target

NAMED, NOTHING = ({"causes": [{"id": x}] if x else []} for x in ("stribeck", None))


def test_every_target_names_parts_of_the_study_and_is_not_run_without_cases():
    asked = []

    class Watched(dict):
        def get(self, key, default=None):
            asked.append(key)
            return default

    assert all(one.judge(one.find(Watched())) == "not run" for one in targets.TARGETS)
    assert set(asked) <= set(GROUPS) and targets.tabulate({}).count("| not run |") == len(
        targets.TARGETS
    )


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [(0.98, 1.0, "met"), (0.9, 1.0, "open"), (0.5, 0.9, "short")],
)
def test_a_target_is_met_or_short_where_the_whole_interval_is(low, high, said):
    target = Target("", 0.97, np.inf, lambda _: None)
    assert target.judge(Found(0.5 * (low + high), low, high, "")) == said


def test_few_clean_rigs_show_nothing_of_a_hundredth():
    target = next(one for one in targets.TARGETS if one.what.startswith("clean rigs"))

    def judge(named, n):
        lines = [NAMED] * named + [NOTHING] * (n - named)
        return target.judge(target.find({"clean": lines}))

    assert judge(0, 40) == "open" and judge(0, 1000) == "met" and judge(30, 1000) == "short"


def test_a_quantile_of_few_values_is_not_bounded():
    few = targets.find_quantile([0.9, 1.0, 1.1, None], 0.05)
    many = targets.find_quantile(np.linspace(0, 1, 1001), 0.05)
    assert few is not None and few.low == -np.inf
    assert many is not None and 0.03 < many.low < 0.05 < many.high < 0.07
    assert targets.find_quantile([None], 0.5) is None


@pytest.mark.parametrize("slope", [0.5, 1.0])
def test_the_slope_of_stated_probabilities_lies_in_its_interval(slope):
    rng = np.random.default_rng(3)
    odds = rng.uniform(-2, 5, 1500)
    right = rng.uniform(size=1500) < 1 / (1 + np.exp(-slope * odds))
    cases = [
        {"causes": [{"id": "stribeck", "probability": 1 / (1 + np.exp(-x))}], "effects": e}
        for x, e in zip(odds, ({"stribeck"} if x else set() for x in right), strict=True)
    ]
    found = targets.find_slope(cases)
    assert found is not None and found.low < slope < found.high < found.low + 0.3
