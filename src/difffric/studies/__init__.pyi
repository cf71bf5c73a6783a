from . import centering_runs as centering_runs
from . import first_runs as first_runs
from . import next_push as next_push
from . import other_centering as other_centering
from . import paper as paper
from . import published_tables as published_tables
from . import sampling as sampling
from . import simulated_rig as simulated_rig
