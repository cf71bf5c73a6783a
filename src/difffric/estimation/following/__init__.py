"""How a fit has its pushes followed: by NumPy in columns, by compiled programs, in threads."""
