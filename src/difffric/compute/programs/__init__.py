"""The store of compiled programs, behind `program_cache.cache_program`.

`store` finds a program by its key on disk, or compiles and puts it there: one thread or process
does, and the others wait. What it puts there is `stripped` of all that running it does not need,
an edit of XLA's own files, which are read and written as `protobuf_wire` has them; it is believed
only where it gives the same bits, once a `trial` in another process, which may end in it, has gone
well (`answer_trials` is that process). `private_folder` guards the folders and holds the locks.
`record` counts what each program costs, where that is asked.
"""
