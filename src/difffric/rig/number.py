"""What the fields of a rig hold, and what its laws take and give."""

from __future__ import annotations

from jaxtyping import Array, Bool, Float

Number = Float[Array, ""] | float
"""A plain float, or a JAX scalar that can be differentiated and batched."""

Truth = Bool[Array, ""] | bool
"""Whether something is so: known when a program is traced, or only when it runs."""
