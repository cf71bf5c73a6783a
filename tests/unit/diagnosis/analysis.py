"""A hidden case and its diagnosis, for the tests of the whole procedure."""

from __future__ import annotations

import numpy as np

import difffric as df
from difffric.rig.setup import Setup
from difffric.rig.setup_toml import read_setup
from tests.hidden import heldout, write
from tests.unit.diagnosis.prediction import prediction_error


class Analysis:
    """A case on disk, its diagnosis, and the prediction of pushes that it has not seen.

    All that shows is a cause, however little it changes, unless another `matters` is given.
    """

    def __init__(self, case, folder, matters=0.0):
        self.case, self.folder = case, folder
        self.path = write(case, folder)
        self.setup = read_setup(folder / "setup.toml")
        self.options = {"use_data_mass": len(case.masses) > 1}
        self.found = df.diagnose(self.setup, df.load(self.path), matters=matters, **self.options)

    @property
    def first(self) -> set[str]:
        """The set that the first cause stands for."""
        first = self.found.causes[0]
        return {first.id, *first.confusable_with}

    def error(self, setup: Setup) -> float:
        """Of a set-up on further pushes of the same rig."""
        new = write(heldout(self.case, len(self.case.pushes)), self.folder / "new")
        noise = self.case.noise.force, np.sqrt(2) * self.case.noise.position
        return prediction_error(setup, df.load(new), noise, **self.options)
