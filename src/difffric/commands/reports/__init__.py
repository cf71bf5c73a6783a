"""What a command says of what it found: the answer for result.json, and the report for a person.

`page` defines a report (a title, a summary, and sections of text, tables and pictures), renders it
as one HTML page, and writes the folder: all of it or nothing. Each other module serves the command
of its name, `fleet` and `fleet_diagnosis` those of `identify` and `diagnose` on an archive:

- `describe_...` returns the answer. `docs/formats.md` states its keys: they are a contract. What
  does not exist is null with a reason, never NaN.
- `report_...` returns the `Report`. Text and numbers are made here, with `number_text`; pictures
  come from `figures`, and only where they are asked for, as matplotlib takes long to load.

To add something to a report, add a table or a picture to one of its sections. A report is loaded
on first use, `reports.fit.report_fit(...)`; a new module is listed in `__init__.pyi`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
