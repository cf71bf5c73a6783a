from . import c_code as c_code
from . import domain as domain
from . import fitting as fitting
from . import predictor as predictor
