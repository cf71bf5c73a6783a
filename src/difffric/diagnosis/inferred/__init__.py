"""What is inferred of friction by a fit, and what an effect changes of it."""
