"""Trees of numbers as JAX sees them: a class is part of the structure."""

import jax
import numpy as np
import pytest

from difffric.compute.number_tree import NumberTree
from difffric.compute.program_cache import cache_program
from difffric.compute.programs.private_folder import FOLDER
from difffric.rig.sensors import ForceSensor, Gain, Lowpass, Offset

SENSOR = ForceSensor()


def test_laws_of_one_form_have_structures_of_their_own():
    made = [jax.tree.structure(law(SENSOR, 1.0)) for law in (Gain, Offset, Lowpass)]
    assert all(a != b for i, a in enumerate(made) for b in made[:i])
    assert made[0] == jax.tree.structure(Gain(SENSOR, 7.0))


def test_a_program_of_one_law_serves_no_other(monkeypatch):
    monkeypatch.delenv(FOLDER, raising=False)  # kept on disk, they had names of their own
    read = cache_program(lambda sensor, force: sensor.read(force))
    three = jax.numpy.asarray(3.0)
    assert float(read(Gain(SENSOR, three), three)) == 9.0
    assert float(read(Offset(SENSOR, three), three)) == 6.0


def test_a_tree_comes_back_from_its_leaves():
    tree = Gain(Offset(SENSOR, 2.0), 3.0)
    leaves, structure = jax.tree.flatten(tree)
    assert jax.tree.unflatten(structure, leaves) == tree
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree.leaves_with_path(tree)]
    assert paths[-2:] == [".law.offset", ".factor"]
    assert jax.tree.map(lambda x: 2 * x, tree) == Gain(
        Offset(jax.tree.map(lambda x: 2 * x, SENSOR), 4.0), 6.0
    )


@pytest.mark.parametrize("number", [1.0, np.arange(3.0), None])
def test_numbers_arrays_and_nothing_may_stand_in_it(number):
    class Pair(NumberTree):
        first: object
        second: object = None

    pair = Pair(number, 2.0)
    assert jax.tree.unflatten(jax.tree.structure(pair), jax.tree.leaves(pair)) == pair
