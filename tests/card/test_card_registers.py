"""One file says what the card's interface is; all that is made from it agrees."""

from __future__ import annotations

import re

import nifpga
import pytest

from difffric.acquisition import card, card_registers
from difffric.acquisition.simulated_card import SimulatedCard
from fpga import generate

INTERFACE = generate.load()
REGISTERS = [*INTERFACE["control"], *INTERFACE["indicator"]]


@pytest.mark.parametrize("path", generate.files(INTERFACE), ids=lambda path: path.name)
def test_what_is_committed_is_what_the_interface_makes(path):
    made = generate.files(INTERFACE)[path].encode()
    assert path.read_bytes() == made, "run .venv/bin/python -m fpga.generate"


def test_nifpga_reads_the_description():
    bitfile = nifpga.Bitfile(str(generate.DESCRIPTION))
    assert bitfile.signature == card_registers.SIGNATURE
    assert bitfile.base_address_on_device() == INTERFACE["card"]["base_address"]
    assert list(bitfile.registers) == [register["name"] for register in REGISTERS]
    for said in REGISTERS:
        read = bitfile.registers[said["name"]]
        assert str(read.datatype) == said["type"].replace("Boolean", "Bool")
        assert read.offset == said["offset"]
        assert read.is_indicator == (said in INTERFACE["indicator"])
        assert not read.is_internal() and not read.access_may_timeout() and not read.is_array()
    assert list(bitfile.fifos) == [fifo["name"] for fifo in INTERFACE["fifo"]]
    for said in INTERFACE["fifo"]:
        read = bitfile.fifos[said["name"]]
        assert (str(read.datatype), read.number) == (said["type"], said["number"])
        assert read.transfer_size_bytes == int(said["type"][1:]) // 8


def test_the_description_says_that_it_is_none_to_load():
    text = generate.DESCRIPTION.read_text(encoding="utf-8")
    assert "no bitstream" in text and "<Bitstream" not in text
    assert ".description." in generate.DESCRIPTION.name


def test_the_library_and_the_simulated_card_have_the_same_interface():
    names = [register["name"] for register in REGISTERS]
    assert [*card.CONTROLS, *card.INDICATORS] == names == list(card_registers.AT_RESET)
    simulated = SimulatedCard(lambda velocity, stroke: (lambda t: (t, t), 1.0))
    assert list(simulated.registers) == names and list(simulated.fifos) == list(card.FIFOS)
    at_reset = {name: register.read() for name, register in simulated.registers.items()}
    assert at_reset == card_registers.AT_RESET | {"sample_rate_Hz": 200_000}


def test_the_signature_changes_with_the_interface_and_not_with_its_sentences():
    def signed(change=lambda interface: None):
        interface = generate.load()
        change(interface)
        return generate.signature(interface)

    said = signed()
    assert re.fullmatch("[0-9A-F]{32}", said)
    assert said == signed(lambda x: x["control"][0].update(text="something else"))
    assert said == signed(lambda x: x["clip"]["signal"].pop())  # not the host's business
    for change in (
        lambda x: x["control"][0].update(type="I32"),
        lambda x: x["indicator"][-1].update(offset=0x18048),
        lambda x: x["indicator"].pop(),
        lambda x: x["fifo"].reverse(),
        lambda x: x["interrupt"][0].update(number=1),
        lambda x: x["words"].update(adc_volts=5.0),
    ):
        assert said != signed(change)


@pytest.mark.parametrize(
    ("find", "put", "words"),
    [
        ('name = "stroke_nm"\ntype = "U32"', 'name = "stroke_nm"\ntype = "FXP"', "stroke_nm"),
        ('name = "stroke_nm"', 'name = "velocity_nm_per_s"', "share one name"),
        ("offset = 0x18004", "offset = 0x18000", "share one offset"),
        ("offset = 0x18004", "offset = 0x18005", "multiple of 4"),
        ("number = 1", "number = 2", "numbered from 0"),
        ('register = "done"', 'register = "ended"', "ended: the signal of a register"),
    ],
)
def test_what_no_card_could_have_is_refused(tmp_path, find, put, words):
    text = generate.SOURCE.read_text(encoding="utf-8")
    assert find in text
    bad = tmp_path / "registers.toml"
    bad.write_text(text.replace(find, put, 1), encoding="utf-8")
    with pytest.raises(ValueError, match=words):
        generate.load(bad)
