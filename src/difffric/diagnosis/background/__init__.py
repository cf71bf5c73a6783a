"""The causes that stand out of a background of small effects.

Read `search` first: it fits all small effects at once (`small_effects`, `joint_fit`), compares sets
of causes where that fit stands (`columns`, `evidence`, `cause_sets`), and frees the best one.
So that the fit arrives, it begins with a `growing_horizon`, a tip that stops by time is found by a
`size_scan`, and waves and patches that stand out are placed in it (`shape_pursuit`).
`naming` says which causes of it are sure and what else could be in their place, `curve_comparison`
and `curve_fit` whether something outside the catalogue explains the data better; `bristles` begins
anew where the search ends at what they are taken for.
"""
