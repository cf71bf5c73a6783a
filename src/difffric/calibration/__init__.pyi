from .calibrate import fit as fit
from .data_comparison import compare_pushes as compare_pushes
from .data_comparison import compare_trace as compare_trace
from .identifiability import identifiable as identifiable
from .optimal_push import next_push as next_push
from .profiles import profile as profile
