"""The columns of a linear comparison: what each parameter, small effect and shape changes where a
fit stands.

`known_columns` are derivatives, `shape_columns` differences, over the grids of the effects that
have no derivative at their nulls.
"""
