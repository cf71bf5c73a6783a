"""Whatever is changed in the VHDL, one of the core's tests fails."""

from __future__ import annotations

import pytest

from tests.card.hdl import simulate
from tests.card.hdl.mutants import UNSEEN, all_mutants

pytestmark = [pytest.mark.slow, simulate.needs("ghdl")]
MUTANTS = all_mutants()


@pytest.mark.parametrize("change", MUTANTS)
def test_a_change_of_the_vhdl_fails_a_test(change, tmp_path):
    changed, text = MUTANTS[change]
    sources = []
    for source in simulate.SOURCES:
        before = source.read_text(encoding="utf-8")
        assert source != changed or text != before
        sources.append(tmp_path / source.name)
        sources[-1].write_text(text if source == changed else before, encoding="utf-8")
    told = simulate.run(simulate.CORE_TESTS, tmp_path, sources=sources)
    assert any(told.values()) != (change in UNSEEN)


def test_what_is_excused_is_there():
    assert set(UNSEEN) <= set(MUTANTS)
