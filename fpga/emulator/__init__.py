"""A card that is not there: NI's C interface, with pushes played behind it."""
