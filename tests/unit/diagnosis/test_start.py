"""Another optimum of a model that has not arrived is found where there is one."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from difffric.diagnosis.lack_of_fit import is_misfit_large
from difffric.diagnosis.start import _is_push_off, find_better_optimum
from difffric.estimation.ensembles import ensemble, ensemble_refits
from tests.unit.diagnosis.linear_rig import LinearModel, make_task, start


@dataclass
class WavingModel(LinearModel):
    """The same with a wave in the last coordinate, which has an optimum a turn."""

    turns: np.ndarray = None  # type: ignore[assignment]
    """(n, 2) by which that coordinate turns each number"""

    def answers(self, index, c, directions):
        """As `ExtendedModel.answers`."""
        linear = replace(self, slopes=self.slopes.copy())
        angle = self.turns[index] * c[:, -1:]
        slopes = self.slopes[index].copy()
        slopes[:, :, -1] = 30 * self.turns[index] * np.cos(angle)
        at = np.einsum("nik,nk->ni", slopes[:, :, :-1], c[:, :-1]) + 30 * np.sin(angle)
        # Linear where it stands: the slopes there, and what is left there.
        linear.slopes, n = slopes, np.arange(len(c))
        linear.measured = self.measured[index] - at + np.einsum("nik,nk->ni", slopes, c)
        return LinearModel.answers(linear, n, c, directions)


@pytest.mark.parametrize("size", [1.7, 0.5])
def test_a_fit_in_a_wrong_optimum_is_led_out_of_it(size):
    rng, n, truth = np.random.default_rng(4), 12, 6.0
    slopes = 50 * rng.standard_normal((n, 2, 2))
    own, turns = 0.01 * rng.standard_normal(n), rng.uniform(0.5, 1.5, (n, 2))
    measured = slopes[:, :, 0] * own[:, None] + 30 * np.sin(turns * truth)
    task = make_task(slopes, measured + rng.standard_normal((n, 2)), ("wave",))
    model = WavingModel(slopes, task.model.measured, ("wave",), turns=turns)  # type: ignore
    task = replace(task, model=model)  # type: ignore[arg-type]
    guess = start(task, 0.01)
    c = guess.c.copy()
    c[0, 1] = size * truth
    stuck = ensemble_refits.refit(task, replace(guess, c=c, extra=((1,),)), 40)
    assert abs(stuck.c[0, 1] - truth) > 0.5
    better = find_better_optimum(task, stuck, guess)
    assert better is not None and better.c[0, 1] == pytest.approx(truth, abs=0.05)
    assert ensemble.criterion(task, better)[0] < ensemble.criterion(task, stuck)[0] - 100
    assert find_better_optimum(task, better, guess) is None


def fit_line(seed: int, wrong: float = 0.0, recordings: bool = True):
    """Pushes with one shared slope, fitted; one number of the first is `wrong` by so much noise."""
    rng = np.random.default_rng(seed)
    slopes = 30 * rng.normal(size=(12, 2, 2))
    measured = slopes[:, :, 1] + rng.normal(size=(12, 2))
    task = make_task(slopes, measured, ("k",), shared=(1,))
    task = replace(task, model=LinearModel(slopes, measured, ("k",), recordings))  # type: ignore
    fits = ensemble_refits.refit(task, start(task, 0.3), 10)
    gram = fits.gram.copy()
    gram[0, 0, 1, -1, -1] += wrong**2
    return task, replace(fits, gram=gram)


@pytest.mark.parametrize("seed", range(3))
def test_one_push_is_off_where_it_leaves_far_more_than_the_others_which_leave_noise(seed):
    assert not _is_push_off(*fit_line(seed))
    assert _is_push_off(*fit_line(seed, wrong=10.0))
    assert not _is_push_off(*fit_line(seed, wrong=10.0, recordings=False))
    task, fits = fit_line(seed, wrong=10.0)
    assert not _is_push_off(task, replace(fits, spread=fits.spread / 10))  # most leave more


def test_a_push_that_is_not_followed_is_a_large_misfit():
    task, fits = fit_line(0, recordings=False)
    assert not is_misfit_large(task, fits)
    residual = fits.residual.copy()
    residual[0, 3] = np.nan
    assert is_misfit_large(task, replace(fits, residual=residual))
