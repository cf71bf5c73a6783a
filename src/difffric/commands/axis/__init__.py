"""The commands where the set-up is that of an axis.

`difffric fit`, `identify`, `diagnose` and `simulate` look at the set-up's file and hand over to
`run`; `report` says what was found in the terms of an axis, and `figures` draws it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
