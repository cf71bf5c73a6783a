"""Many fits of one data set at once, which share the compiled program: what they are and cost, how
they move, where a push has several mu_s that fit, and what they foresee of held-out pushes."""
