from .load_file import load as load
from .pushes import Pushes as Pushes
from .recordings import Channel as Channel
from .recordings import Recording as Recording
from .recordings import Recordings as Recordings
from .reduction.reduce import reduce_push as reduce_push
from .reduction.reduce import reduce_recordings as reduce_recordings
