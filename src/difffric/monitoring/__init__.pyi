from . import feed as feed
from .monitor import Monitor as Monitor
