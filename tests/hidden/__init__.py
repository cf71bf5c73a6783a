"""Cases with a hidden effect for `difffric diagnose`, from the reference alone.

case = random_case(7, "stribeck", strength=10)
write(case, folder)
"""

from tests.hidden.case import Case, Noise, Push
from tests.hidden.draw import random_case, with_nuisances
from tests.hidden.scaling import with_strength
from tests.hidden.signal import Invisible, cosine, own_strength, strength
from tests.hidden.simulate import friction_of, heldout, record, table, write

__all__ = [
    "Case",
    "Invisible",
    "Noise",
    "Push",
    "cosine",
    "friction_of",
    "heldout",
    "own_strength",
    "random_case",
    "record",
    "strength",
    "table",
    "with_nuisances",
    "with_strength",
    "write",
]
