"""The files of an axis.

`load_recording` reads what was recorded, a text with a row a sample or a `.tdms` with a group a
stretch, into SI units; `setup_file` reads and writes the set-up, with all its problems named at
once; `file_kind` tells a file of an axis from one of pushes.
"""
