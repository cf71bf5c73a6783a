"""What is inferred of friction by a fit, what an effect changes of it, and what is each push's own.

`friction` gives the mu_s of each push by a fit, with its standard error; `curve_size` does beside a
free curve. `changes` says by how much an effect changes that mu_s, F_p and d. `push_offsets` finds
by how much the trigger, the force's zero and the speed of each push are off.
"""
