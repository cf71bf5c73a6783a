from . import controller as controller
from . import surrogates as surrogates
from .controller.fitting import fit_predictor as fit_predictor
from .controller.predictor import Predictor as Predictor
from .estimators import identify as identify
from .fast_identifier import identifier as identifier
from .inversion import invert as invert
