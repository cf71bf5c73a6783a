"""What is inferred of friction by a fit, and what an effect changes of it.

`friction` gives the mu_s of each push by a fit, with its standard error. `changes` says by how much
an effect changes that mu_s, F_p and d.
"""
