"""The command line, `difffric`: each command prints tables for a person and leaves its answer in
the folder that `--out` names.

- `main` lists the commands, and imports a command's module when it is called.
- `simulate`, `family`, `acquire`, `fit`, `identify`, `diagnose`, `monitor`, `ring`, `plan`,
  `centre`, `export`, `warm` and `paper` hold a function of their own name each: it checks the
  options, calls the package that does the work, and hands what was found to its report.
- `first_steps` holds those for the first minutes with data of one's own (`init`, `check`);
  `running` what is the same for all: what is shown meanwhile, Ctrl-C, and `report-bug`.
- `options` and `fleet_options` hold the options that several commands share; `console` shows
  progress, prints tables and writes the folder.
- `reports` turns what was found into result.json and a page, `figures` into pictures;
  `figures.live_view` shows pushes while they are recorded.

A new command is a function in a module of its own, a line in `main.COMMANDS`, and a report. It
calls the library by its public face, `import difffric as df`, and its report through `reports`:
both load their parts on first use, so that imports stand at the top and help comes at once.
"""
