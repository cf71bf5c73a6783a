"""64 bits for every test, as the command line and the notebooks have it."""

import jax

jax.config.update("jax_enable_x64", True)
