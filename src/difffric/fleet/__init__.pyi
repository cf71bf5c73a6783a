from .diagnose_archive import diagnose_fleet as diagnose_fleet
from .identify_archive import data_set as data_set
from .identify_archive import identify_fleet as identify_fleet
