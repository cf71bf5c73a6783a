"""The formats of measured data: tables (.csv) and recordings (.tdms).

- `table_csv` reads and writes `Pushes`, a row a push.
- `named_columns` reads any delimited text as named columns in SI; `delimited_text` finds encoding,
  separators and header, `decimal_marks` points and commas. `measurements.headings` knows names and
  units.
- `tdms_reader` reads `Recordings`, a group a push, a channel a signal; `tdms_segments` walks the
  file's structure, as far as it is whole, and `tdms_samples` reads samples when asked for.
- `tdms_writer` writes recordings whole, or streams them while they are recorded.

npTDMS knows the types, scalings and the writing of segments; walking a file that is cut off, and
naming what is wrong with it by group and channel, is done here.

To add a format, write a function `read_...(path, *, skip_bad=False)` that gives `Pushes` or
`Recordings` and raises one `InputError` that names everything wrong by its place in the file; then
give `load_file.load` its suffix, the fuzz tests a sample, and `docs/formats.md` a section. Names,
units and ranges come from `measurements.quantities`, never from the format.
"""
