"""Candidates for one more cause: where the search for an effect starts, and which it leads to.

`effect_search` makes the starts of an effect and says what a step from them promises. `table_scan`
looks through all sizes of all effects with a table's pushes.
"""
