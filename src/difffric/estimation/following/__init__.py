"""How a fit has its pushes followed.

`respond_in_columns` does it by NumPy, all pushes at once, where every law is affine;
`answer_by_program` has the program for every effect, `compiled_search` those for all else and for a
table's whole search; `thread_pool` runs several of them beside each other.
"""
