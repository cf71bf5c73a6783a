"""The causes that stand out of a background of small effects.

Read `search` first: it fits all small effects at once (`small_effects`, `joint_fit`), compares sets
of causes where that fit stands (`shape_columns`, `evidence`, `cause_sets`), and frees the best one.
`naming` says which causes of it are sure and what else could be in their place, `free_curves`
whether something outside the catalogue explains the data better.
"""
