"""What the fields of a rig hold, and what its laws take and give."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from jaxtyping import Array, Bool, Float

Number: TypeAlias = "Float[Array, ''] | float"
"""A plain float, or a JAX scalar that can be differentiated and batched; as `compute.arrays` takes
them, a column of NumPy's or of dual numbers too."""

Truth: TypeAlias = "Bool[Array, ''] | bool"
"""Whether something is so: known when a program is traced, or only when it runs."""
