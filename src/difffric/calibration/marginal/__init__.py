"""The marginal likelihood of a table or of free slides: each push's own mu_s integrated out.

`MarginalLikelihood` (`marginal_likelihood`) is the one function by which fits compete, are brought
to their optimum (`polish`), get their error bars and are profiled. What it is made of:

1. `node_answers` gives the model's numbers and derivatives for many pushes at many mu_s.
2. `push_integrals` integrates over mu_s, exactly for a model that is linear between the points.
"""
