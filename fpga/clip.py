"""The declaration by which LabVIEW FPGA takes fpga/hdl as component-level IP (CLIP)."""

from __future__ import annotations

from typing import Any

from fpga.markup import element

BITS = {"Boolean": 1, "U8": 8, "I16": 16, "U16": 16, "I32": 32, "U32": 32, "I64": 64, "U64": 64}
"""of the types that a signal may have: LabVIEW takes one of another width for fixed-point"""

Table = dict[str, Any]


def signals(card: Table) -> list[Table]:
    """The declared signals, each with its own `name`, `type`, `direction` and `text`."""
    directions = {"control": "in", "indicator": "out", "fifo": "out"}
    known = {
        (kind, entry["name"]): {key: entry[key] for key in ("name", "type", "text")}
        | {"direction": direction}
        for kind, direction in directions.items()
        for entry in card[kind]
    }
    found = []
    for said in card["clip"]["signal"]:
        kinds = ("fifo",) if "fifo" in said else ("control", "indicator")
        name = said.get("fifo", said.get("register"))
        of = next((known[kind, name] for kind in kinds if (kind, name) in known), {})
        if name is not None and not of:
            raise ValueError(f"{name}: the signal of a register or FIFO that is not there")
        entry = of | {key: said[key] for key in said if key not in ("register", "fifo")}
        if entry["type"] not in BITS:
            raise ValueError(f"{entry['name']}: no signal can be {entry['type']}")
        found.append(entry)
    names = [card["clip"][one]["name"] for one in ("clock", "reset")]
    names += [entry["name"] for entry in found]
    if len(set(names)) != len(names):
        raise ValueError(f"two signals share one name: {names}")
    return found


def hdl_type(kind: str) -> str:
    """The port's type, letter by letter as the declaration must have it."""
    return "std_logic" if BITS[kind] == 1 else f"std_logic_vector({BITS[kind] - 1} downto 0)"


def declaration(card: Table, made: str) -> str:
    """fpga/hdl/<name>.xml."""
    core = card["clip"]
    clock, reset = core["clock"], core["reset"]

    def signal(entry: Table, kind: str, *more: str) -> str:
        return element(
            "Signal",
            element("HDLName", entry["name"]),
            element("HDLType", hdl_type(entry.get("type", "Boolean"))),
            element("Direction", "FromCLIP" if entry.get("direction") == "out" else "ToCLIP"),
            element("SignalType", kind),
            element("DataType", element(entry.get("type", "Boolean"))),
            element("Description", entry["text"]),
            *more,
            attributes=f' Name="{entry["name"]}"',
        )

    def interface(kind: str, *inside: str) -> str:
        return element(
            "Interface",
            element("InterfaceType", kind),
            element("SignalList", *inside),
            attributes=f' Name="{kind}"',
        )

    # Strobes last one cycle: a single-cycle Timed Loop, and no other, sees each of them.
    in_the_loop = (
        element("RequiredClockDomain", clock["name"]),
        element("UseInLabVIEWSingleCycleTimedLoop", "Required"),
    )
    frequency = element("FreqInHertz", element("Max", clock["max"]), element("Min", clock["min"]))
    model = element("Entity", core["name"]), element("Architecture", core["architecture"])
    top, *others = core["files"]
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f"<!-- {made}. -->\n"
        + element(
            "CLIPDeclaration",
            element("FormatVersion", "4.3"),
            element("Description", core["text"]),
            element("SupportedDeviceFamilies", "Unlimited"),
            element(
                "TopLevelEntityAndArchitecture",
                element("SynthesisModel", *model),
                element("SimulationModel", *model),
            ),
            element(
                "InterfaceList",
                interface(
                    "LabVIEW",
                    signal(clock, "clock", frequency),
                    *(signal(entry, "data", *in_the_loop) for entry in core["signal"]),
                ),
                interface("Fabric", signal(reset, "reset")),
            ),
            element(
                "ImplementationList",
                element("Path", element("TopLevel"), attributes=f' Name="{top}"'),
                *(element("Path", attributes=f' Name="{name}"') for name in others),
            ),
            attributes=f' Name="{core["name"]}"',
        )
        + "\n"
    )
