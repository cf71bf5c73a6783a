"""What an unexpected failure said, kept for a report of the fault.

It is kept without what is the user's own: names of files stand as `<name 1>.csv`, in the order of
the command line, and folders outside the libraries not at all.
"""

from __future__ import annotations

import os
import re
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from difffric.atomic_files import write_whole
from difffric.commands.running.durations import CACHE
from difffric.commands.running.versions import list_versions
from difffric.errors import InputError

_FILE = "last_error.md"
_FRAME = re.compile(r'File "([^"]+)"')
_INSTALLED = re.compile(r"^.*?/((?:site-packages|dist-packages|lib/python[\d.]+)/.*)$")
_PACKAGE = Path(__file__).parents[2]
_OWN_WORDS = ("--free", "--per-condition", "--held-out")
"""Options whose values are words of ours."""


def keep_error(error: BaseException, words: Sequence[str]) -> bool:
    """Keep what went wrong, as text for `difffric report-bug`; `words` are those of the command
    line. Returns whether that was possible."""
    folder = os.environ.get(CACHE)
    if not folder:
        return False
    text = describe_error(error, words)
    with suppress(OSError, InputError):
        Path(folder).mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(Path(folder) / _FILE, lambda file: file.write(text.encode()))
        return True
    return False


def read_error() -> str | None:
    """Return what was kept of the last failure; None where there is nothing."""
    with suppress(OSError, KeyError):
        return (Path(os.environ[CACHE]) / _FILE).read_text(encoding="utf-8")
    return None


def describe_error(error: BaseException, words: Sequence[str]) -> str:
    """Return a failure as Markdown: when, the command line, the versions, the traceback."""
    names = _name_words(words)
    when = time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime())
    command = ["difffric"]
    for word in words:
        option, equals, value = word.partition("=")
        named = f"{option}={names[value]}" if equals and value in names else word
        command.append(names.get(word, named))
    trace = []
    for entry in traceback.format_exception(error):
        if entry.startswith("  File"):  # our own lines, where a name of a file may be a word
            trace.append(_FRAME.sub(lambda found: f'File "{_shorten_path(found[1])}"', entry))
        else:
            trace.append(_hide(entry, names))
    return "\n".join(
        [
            f"At {when} UTC:",
            "",
            *_fence([" ".join(command)]),
            "",
            *_fence(list_versions()),
            "",
            *_fence("".join(trace).rstrip().splitlines()),
            "",
        ]
    )


def find_place(error: BaseException) -> str:
    """Return the last line of this library that an error went through, as `fit.py:12`."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if Path(frame.filename).is_relative_to(_PACKAGE):
            return f"{Path(frame.filename).relative_to(_PACKAGE.parent).as_posix()}:{frame.lineno}"
    return "outside difffric"


def _name_words(words: Sequence[str]) -> dict[str, str]:
    """Give each word of a command line that may be the user's, a file's name above all, one of our
    own."""
    found: dict[str, str] = {}
    for before, word in zip(["", *words], words, strict=False):
        option, equals, value = word.partition("=")
        if not (option.startswith("--") and equals):
            option, value = before, word
        is_ours = not before or option in _OWN_WORDS or value.startswith("-") or _is_number(value)
        if value and not is_ours:
            found.setdefault(value, f"<name {len(found) + 1}>{Path(value).suffix}")
    return found


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _hide(text: str, names: dict[str, str]) -> str:
    """Put our names in place of the user's, also where only the last part of a path is told."""
    everywhere = {
        told: own
        for name, own in names.items()
        for told in (name, os.path.abspath(name), Path(name).name)
        if len(told) > 2
    }
    for name in sorted(everywhere, key=len, reverse=True):
        own = everywhere[name]
        text = re.sub(rf"(?<![\w<]){re.escape(name)}(?!\w)", lambda _, own=own: own, text)
    home = os.path.expanduser("~")
    return text.replace(home, "~") if len(home) > 1 else text


def _shorten_path(path: str) -> str:
    """Return the path of a module from its library on."""
    if Path(path).is_relative_to(_PACKAGE):
        return Path(path).relative_to(_PACKAGE.parent).as_posix()
    found = _INSTALLED.match(Path(path).as_posix())
    return found[1] if found else Path(path).name


def _fence(lines: Sequence[str]) -> list[str]:
    return ["```text", *lines, "```"]
