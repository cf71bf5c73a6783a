"""Everything that is made from registers.toml: `.venv/bin/python -m fpga.generate`."""

from __future__ import annotations

import hashlib
import json
import tomllib
from pathlib import Path
from typing import Any

from fpga import clip
from fpga.markup import element

HERE = Path(__file__).parent
ROOT = HERE.parent
SOURCE = HERE / "registers.toml"
DESCRIPTION = HERE / "difffric_push.description.lvbitx"
MADE = "Made from fpga/registers.toml by fpga/generate.py"

BITS = {"Boolean": 1, "I8": 8, "U8": 8, "I16": 16, "U16": 16, "I32": 32, "U32": 32}
"""of the types that a register may have"""
FIFO_BITS = BITS | {"Boolean": 8, "I64": 64, "U64": 64}

Table = dict[str, Any]


def load(path: Path = SOURCE) -> Table:
    """The interface, checked. Raises `ValueError` for what no card could have."""
    card = tomllib.loads(path.read_text(encoding="utf-8"))
    for kind, types in (("control", BITS), ("indicator", BITS), ("fifo", FIFO_BITS)):
        for entry in card[kind]:
            if entry["type"] not in types:
                raise ValueError(f"{entry['name']}: no {kind} can be {entry['type']}")
    registers = [*card["control"], *card["indicator"]]
    for key, entries in (
        ("name", [*registers, *card["fifo"]]),
        ("offset", registers),
        ("number", card["fifo"]),
        ("number", card["interrupt"]),
    ):
        values = [entry[key] for entry in entries]
        if len(set(values)) != len(values):
            raise ValueError(f"two entries share one {key}: {values}")
    if [fifo["number"] for fifo in card["fifo"]] != list(range(len(card["fifo"]))):
        raise ValueError("FIFOs are numbered from 0 in their order, as in a .lvbitx")
    for register in registers:
        register.setdefault("at_reset", False if register["type"] == "Boolean" else 0)
        if register["offset"] % 4:
            raise ValueError(f"{register['name']}: a register begins at a multiple of 4 bytes")
    card["clip"]["signal"] = clip.signals(card)
    return card


def signature(card: Table) -> str:
    """32 hexadecimal digits that change with anything of the host's interface but the sentences."""

    def bare(value: Any) -> Any:
        if isinstance(value, list):
            return [bare(item) for item in value]
        if isinstance(value, dict):
            return {key: bare(item) for key, item in value.items() if key != "text"}
        return value

    interface = {key: value for key, value in card.items() if key != "clip"}
    canonical = json.dumps(bare(interface), sort_keys=True)
    return hashlib.sha256(canonical.encode()).hexdigest()[:32].upper()


def description(card: Table) -> str:
    """The registers and FIFOs in the form of a .lvbitx, without a bitstream."""

    def register(entry: Table, indicator: bool) -> str:
        return element(
            "Register",
            element("Name", entry["name"]),
            element("Hidden", "false"),
            element("Indicator", str(indicator).lower()),
            element("Datatype", element(entry["type"], element("Name", entry["name"]))),
            element("Offset", str(entry["offset"])),
            element("SizeInBits", str(BITS[entry["type"]])),
            element("Internal", "false"),
            element("AccessMayTimeout", "false"),
        )

    def channel(entry: Table) -> str:
        return element(
            "Channel",
            element("Number", str(entry["number"])),
            element("DataType", element("SubType", entry["type"])),
            element("Direction", "TargetToHost"),
            element("TransferSizeBytes", str(FIFO_BITS[entry["type"]] // 8)),
            attributes=f' name="{entry["name"]}"',
        )

    nifpga = element(
        "NiFpga",
        element("BaseAddressOnDevice", str(card["card"]["base_address"])),
        element("DmaChannelAllocationList", *map(channel, card["fifo"])),
    )
    results = element("CompilationResultsTree", element("CompilationResults", nifpga))
    bitfile = element(
        "Bitfile",
        element("SignatureRegister", signature(card)),
        element(
            "VI",
            element("Name", card["card"]["name"]),
            element(
                "RegisterList",
                *(register(entry, False) for entry in card["control"]),
                *(register(entry, True) for entry in card["indicator"]),
            ),
        ),
        element("Project", results),
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f"<!-- {MADE}.\n"
        "     A description of registers and FIFOs that nifpga reads as it reads a .lvbitx.\n"
        "     There is no bitstream in it: nothing that a card could be loaded with. -->\n"
        f"{bitfile}\n"
    )


WORDS = {
    "adc_volts": "[V], the converter's range, either sign",
    "metres_per_count": "[m], the encoder's step",
}
"""what the numbers are that turn words of the card into units"""


def constants(card: Table) -> str:
    """src/difffric/acquisition/card_registers.py."""

    def table(name: str, values: dict[str, str]) -> list[str]:
        return [f"{name} = {{", *(f'    "{key}": {value},' for key, value in values.items()), "}"]

    def said(entries: list[Table]) -> dict[str, str]:
        return {entry["name"]: f'"{entry["type"]}: {entry["text"]}"' for entry in entries}

    registers = [*card["control"], *card["indicator"]]
    lines = [
        f'"""{MADE}: the card\'s interface."""',
        "",
        f'SIGNATURE = "{signature(card)}"',
        *table("CONTROLS", said(card["control"])),
        *table("INDICATORS", said(card["indicator"])),
        *table("FIFOS", said(card["fifo"])),
        *table("AT_RESET", {entry["name"]: repr(entry["at_reset"]) for entry in registers}),
        '"""what each register holds after a reset"""',
        *(
            f"IRQ_{entry['name'].upper()} = {entry['number']}  # number of the interrupt"
            for entry in card["interrupt"]
        ),
        *(f"{name.upper()} = {value!r}  # {WORDS[name]}" for name, value in card["words"].items()),
    ]
    return "\n".join(lines) + "\n"


def header(card: Table) -> str:
    """fpga/emulator/registers.h."""

    def names(entries: list[Table], prefix: str) -> list[str]:
        return [f"    {prefix}{entry['name'].upper()}," for entry in entries]

    def macro(name: str, rows: list[str]) -> list[str]:
        return " \\\n".join([f"#define {name}", *(f"    {{{row}}}," for row in rows)]).splitlines()

    def register(entry: Table, kind: str) -> str:
        kept = entry["type"].replace("Boolean", "Bool")
        address = card["card"]["base_address"] + entry["offset"]
        return f'"{entry["name"]}", TYPE_{kept}, {kind}, {address}, {int(entry["at_reset"])}'

    registers = [*card["control"], *card["indicator"]]
    kinds = ["CONTROL"] * len(card["control"]) + ["INDICATOR"] * len(card["indicator"])
    fifos = [f'"{x["name"]}", TYPE_{x["type"]}, {FIFO_BITS[x["type"]] // 8}' for x in card["fifo"]]
    lines = [
        f"/* {MADE}. */",
        "#pragma once",
        "",
        f'#define SIGNATURE "{signature(card)}"',
        *(f"#define IRQ_{x['name'].upper()} (1u << {x['number']})" for x in card["interrupt"]),
        "",
        "enum {",
        *names(registers, "REG_"),
        "    REGISTERS,  /* how many */",
        "};",
        "/* name, type, kind, address, value after a reset */",
        *macro("REGISTER_TABLE", list(map(register, registers, kinds))),
        "",
        "enum {",
        *names(card["fifo"], "FIFO_"),
        "    FIFOS,",
        "};",
        "/* name, type, bytes of an element */",
        *macro("FIFO_TABLE", fifos),
    ]
    return "\n".join(lines) + "\n"


_PAGE = """# The card's interface

Made from [`fpga/registers.toml`](../fpga/registers.toml) by `fpga/generate.py`, as are
[the description that nifpga reads](../fpga/{description}), the constants in
`difffric.acquisition.card_registers` and the emulator's table. The signature changes with anything
below but the sentences: `{signature}`.

The description is no bitfile: no card can be loaded with it. Whoever builds one gives it these
names and types; its offsets and its signature are then its own, and nifpga takes them from it.
[The logic between them](../fpga/README.md) is in VHDL.

## Registers

Addresses are from the card's base, {base}. The start of a push puts every indicator but
`sample_rate_Hz` back to what it holds after a reset.

| control | type | offset | unit | after a reset | |
| --- | --- | --- | --- | --- | --- |
{controls}

| indicator | type | offset | unit | after a reset | |
| --- | --- | --- | --- | --- | --- |
{indicators}

**Contact** follows the force word, sample by sample. At the start of a push there is none. It is
made at the first sample that reaches `contact_threshold_word + contact_hysteresis_word`, and then
lost at the first that falls below `contact_threshold_word`; this may go on several times. The latch
holds the last loss, so that `release_count` is where the part left the pusher for good. Where
`released` is false at the push's end, the part rests in contact or was never touched. After a reset
contact is lost below {lost:.0f} N and made at {made_at:.0f} N, for a sensor of 11.2 mV/N.

**Saturated** is a force word of -32768 or 32767, or the mean of conversions of which one is, where
the card averages. **Overflow** has no status of its own: a full FIFO closes both until the push
ends, `streamed` stops, and `samples` goes on.

## FIFOs

From the card to the host.

| FIFO | number | type | unit | |
| --- | --- | --- | --- | --- |
{fifos}

A force word is {volts} V / 2^15, an encoder's count {step:g} nm. Both words of a sample go into
their FIFOs together or not at all.

## Interrupts

| IRQ | name | |
| --- | --- | --- |
{interrupts}
"""


def page(card: Table) -> str:
    """docs/card.md."""

    def register(entry: Table) -> str:
        value = str(entry["at_reset"]).lower()
        return (
            f"| `{entry['name']}` | {entry['type']} | {entry['offset']:#x} "
            f"| {entry.get('unit', '')} | {value} | {entry['text']} |"
        )

    newton = 11.2e-3 / (card["words"]["adc_volts"] / 2**15)  # in force words
    at_reset = {entry["name"]: entry["at_reset"] for entry in card["control"]}
    lost = at_reset["contact_threshold_word"] / newton
    return _PAGE.format(
        description=DESCRIPTION.name,
        signature=signature(card),
        base=f"{card['card']['base_address']:#x}",
        controls="\n".join(map(register, card["control"])),
        indicators="\n".join(map(register, card["indicator"])),
        fifos="\n".join(
            f"| `{x['name']}` | {x['number']} | {x['type']} | {x.get('unit', '')} | {x['text']} |"
            for x in card["fifo"]
        ),
        interrupts="\n".join(
            f"| {x['number']} | `{x['name']}` | {x['text']} |" for x in card["interrupt"]
        ),
        lost=lost,
        made_at=lost + at_reset["contact_hysteresis_word"] / newton,
        volts=f"{card['words']['adc_volts']:g}",
        step=card["words"]["metres_per_count"] * 1e9,
    )


def files(card: Table) -> dict[Path, str]:
    """What is made, and where it goes."""
    return {
        DESCRIPTION: description(card),
        HERE / "emulator" / "registers.h": header(card),
        HERE / "hdl" / f"{card['clip']['name']}.xml": clip.declaration(card, MADE),
        ROOT / "docs" / "card.md": page(card),
        ROOT / "src" / "difffric" / "acquisition" / "card_registers.py": constants(card),
    }


def main() -> None:
    for path, text in files(load()).items():
        path.write_text(text, encoding="utf-8", newline="\n")
        print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
