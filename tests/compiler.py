"""What a test needs that builds the emulated card."""

from __future__ import annotations

import pytest

from fpga.emulator.emulator import NoCompilerError, compiler


def _why_not() -> str:
    try:
        compiler()
    except NoCompilerError as error:
        return str(error)
    return ""


needs_compiler = pytest.mark.skipif(bool(_why_not()), reason=_why_not())
