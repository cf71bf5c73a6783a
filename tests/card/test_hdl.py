"""The FPGA's core: its ports are what LabVIEW is told, it does what docs/card.md says, as VHDL and
as a netlist, and it is small."""

from __future__ import annotations

import random
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from difffric.acquisition import card_registers
from difffric.acquisition.card import position_words
from difffric.acquisition.hardware_check import Watch
from fpga import clip, generate
from tests.card.hdl import control_tests, core_tests, reference, simulate
from tests.card.hdl.coverage import covered
from tests.card.hdl.netlist import synthesized

INTERFACE = generate.load()
CORE = INTERFACE["clip"]
needs_ghdl = simulate.needs("ghdl")
needs_yosys = simulate.needs("ghdl", "yosys")
needs_icarus = simulate.needs("ghdl", "yosys", "iverilog")
needs_gcov = simulate.needs("ghdl", "ghdl-gcc", "gcov")
TESTS = [
    test.name
    for module in (core_tests, control_tests)
    for test in vars(module).values()
    if hasattr(test, "generate_tests")
]
ALWAYS = "last <= '1' when number = size - 1 else '0';"


# What LabVIEW is told


def ports() -> dict[str, tuple[str, str]]:
    """(direction, type) of each of the entity's ports, read from the VHDL."""
    text = (simulate.HDL / CORE["files"][0]).read_text(encoding="utf-8")
    entity = re.search(rf"entity {CORE['name']} is\s+port \((.*?)\n  \);", text, re.DOTALL)
    assert entity, "the top level has generics, or no ports"
    found = {}
    for line in entity[1].strip().splitlines():
        port = re.fullmatch(r"\s*(\w+) : (in|out) (std_logic(?:_vector\(\d+ downto 0\))?);?", line)
        assert port, line
        found[port[1]] = port[2], port[3]
    return found


def declared() -> dict[str, dict[str, str]]:
    """Each signal's interface and elements, read from the XML."""
    root = ElementTree.parse(simulate.HDL / f"{CORE['name']}.xml").getroot()
    found = {}
    for interface in root.iterfind("InterfaceList/Interface"):
        for signal in interface.iterfind("SignalList/Signal"):
            says = {child.tag: child.text or "" for child in signal if len(child) == 0}
            (kind,) = signal.iterfind("DataType/*")
            says |= {"DataType": kind.tag, "Interface": interface.findtext("InterfaceType") or ""}
            assert signal.attrib["Name"] == says["HDLName"]
            found[says["HDLName"]] = says
    return found


def test_the_declared_signals_are_the_entity_s_ports():
    directions = {"in": "ToCLIP", "out": "FromCLIP"}
    told = {name: (says["Direction"], says["HDLType"]) for name, says in declared().items()}
    assert told == {name: (directions[way], kind) for name, (way, kind) in ports().items()}


def test_a_port_is_as_wide_as_what_labview_wires_to_it():
    for name, says in declared().items():
        width = re.fullmatch(r"std_logic_vector\((\d+) downto 0\)", says["HDLType"])
        bits = re.fullmatch(r"[IU](\d+)", says["DataType"])
        assert (says["DataType"] == "Boolean") == (says["HDLType"] == "std_logic"), name
        assert (int(width[1]) + 1 if width else 1) == (int(bits[1]) if bits else 1), name


def test_clock_reset_and_data_are_declared_as_labview_wants_them():
    told = declared()
    clock, reset = CORE["clock"]["name"], CORE["reset"]["name"]
    for name, says in told.items():
        kind = {clock: "clock", reset: "reset"}.get(name, "data")
        assert says["SignalType"] == kind
        # LabVIEW does not import a reset of its own interface.
        assert says["Interface"] == ("Fabric" if kind == "reset" else "LabVIEW")
        in_the_loop = says.get("RequiredClockDomain"), says.get("UseInLabVIEWSingleCycleTimedLoop")
        assert in_the_loop == ((clock, "Required") if kind == "data" else (None, None))


def test_the_declaration_names_the_vhdl_beside_it():
    root = ElementTree.parse(simulate.HDL / f"{CORE['name']}.xml").getroot()
    paths = root.findall("ImplementationList/Path")
    assert [path.attrib["Name"] for path in paths if path.find("TopLevel") is not None] == [
        f"{CORE['name']}.vhd"
    ]
    files = {path.name for path in simulate.HDL.glob("*.vhd")}
    assert {path.attrib["Name"] for path in paths} == files
    text = (simulate.HDL / f"{CORE['name']}.vhd").read_text(encoding="utf-8")
    for model in ("SynthesisModel", "SimulationModel"):
        at = f"TopLevelEntityAndArchitecture/{model}"
        entity, body = root.findtext(f"{at}/Entity"), root.findtext(f"{at}/Architecture")
        assert (
            f"\nentity {entity} is\n" in text and f"\narchitecture {body} of {entity} is\n" in text
        )


def test_the_core_has_every_register_and_word_that_is_not_the_block_diagram_s():
    """Of the block diagram are the motion's settings and the samples' rate."""
    its_own = {"velocity_nm_per_s", "stroke_nm", "quiet_samples", "rest_samples", "sample_rate_Hz"}
    registers = {entry["name"]: entry for entry in INTERFACE["control"] + INTERFACE["indicator"]}
    told = declared()
    assert set(registers) - set(told) == its_own
    for name in set(registers) - its_own:
        assert told[name]["DataType"] == registers[name]["type"]
        is_control = registers[name] in INTERFACE["control"]
        assert told[name]["Direction"] == ("ToCLIP" if is_control else "FromCLIP")
    for fifo in INTERFACE["fifo"]:
        assert told[f"{fifo['name']}_word"]["DataType"] == fifo["type"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda signals: signals[0].update(type="I24"), "no signal can be I24"),
        (lambda signals: signals[0].update(name="adc_word"), "share one name"),
        (lambda signals: signals.append({"register": "peak"}), "peak"),
        (lambda signals: signals.append({"fifo": "done"}), "done"),
    ],
)
def test_a_declaration_that_cannot_be_is_refused(change, words):
    card = generate.load()
    change(card["clip"]["signal"])
    with pytest.raises(ValueError, match=words):
        clip.signals(card)


# What it does


def test_the_reference_sees_what_the_host_does():
    """The plain Python that the core is held to, against the library's own check of recordings."""
    draw = random.Random(1)
    for _ in range(20):
        model, watch = reference.Core(), Watch(74, 184)
        for _ in range(4):
            model.cycle(reference.INPUTS)
        model.cycle(reference.INPUTS | {"start": 1})
        ends = [-(2**15), 2**15 - 1, 0, 73, 74, 183, 184]
        words = [draw.choice([*ends, draw.randint(-99, 299)]) for _ in range(100)]
        for word in words:
            a, b = reference.AROUND[draw.randrange(2)]
            pins = {"encoder_a": a, "encoder_b": b, "start": 1}
            model.cycle(reference.INPUTS | {"converted": 1, "adc_word": word} | pins)
        force, position = (np.array(column) for column in zip(*model.words, strict=True))
        count = position.astype(np.uint64).astype(np.uint32).view(np.int32)
        assert position.tolist() == position_words(np.arange(100), count).tolist()
        watch.add(force.astype(np.int16), count)
        assert force.tolist() == words and watch.compare(model.says, lost=0).agrees
    assert reference.AT_RESET == {name: card_registers.AT_RESET[name] for name in model.says}


@pytest.fixture(scope="module")
def netlist(tmp_path_factory):
    return synthesized(tmp_path_factory.mktemp("netlist"))


@pytest.fixture(scope="module")
def vhdl_says(tmp_path_factory):
    """Why each of the core's tests failed; empty where it did not."""
    return simulate.run(simulate.CORE_TESTS, tmp_path_factory.mktemp("vhdl"))


@pytest.fixture(scope="module")
def netlist_says(netlist, tmp_path_factory):
    sources = [netlist.verilog, netlist.models]
    folder = tmp_path_factory.mktemp("icarus")
    return simulate.run(simulate.CORE_TESTS, folder, sources=sources)


@needs_ghdl
@pytest.mark.parametrize("name", TESTS)
def test_the_vhdl(vhdl_says, name):
    assert vhdl_says[name] == ""


@needs_icarus
@pytest.mark.parametrize("name", TESTS)
def test_the_netlist(netlist_says, name):
    assert netlist_says[name] == ""


@needs_ghdl
@pytest.mark.parametrize("standard", ["93", "02", "08"])
def test_each_vhdl_is_taken_without_a_warning(standard, tmp_path):
    for source in simulate.SOURCES:
        assert simulate.call("ghdl", "-a", f"--std={standard}", source, folder=tmp_path) == ""


# What it takes


@needs_yosys
def test_the_core_has_no_latch_and_is_small(netlist):
    assert netlist.count("LD", "$") == 0
    assert 0 < netlist.luts <= 500 and 0 < netlist.flip_flops <= 400


@needs_yosys
@pytest.mark.parametrize(
    ("put", "words"),
    [
        (ALWAYS.replace(" else '0'", ""), "latch"),
        ("process (number) begin if number = 0 then last <= '0'; end if; end process;", "latch"),
        (f"{ALWAYS}\n  last <= converted;", "multiple"),
    ],
    ids=["latch by an assignment", "latch by a process", "two drivers"],
)
def test_a_latch_or_a_net_with_two_drivers_is_found(put, words, tmp_path):
    texts = {source.name: source.read_text(encoding="utf-8") for source in simulate.SOURCES}
    assert sum(text.count(ALWAYS) for text in texts.values()) == 1
    for name, text in texts.items():
        (tmp_path / name).write_text(text.replace(ALWAYS, put), encoding="utf-8")
    with pytest.raises(RuntimeError, match=words):
        synthesized(tmp_path, [tmp_path / name for name in texts])


@needs_gcov
def test_the_tests_reach_every_branch_of_the_vhdl(tmp_path):
    found = covered(tmp_path)
    assert found.missed == frozenset() and found.ways > found.lines / 4
    # One test by itself does not: what is missed would be seen.
    (tmp_path / "one").mkdir()
    one = covered(tmp_path / "one", only="nothing_is_taken_before_a_push")
    assert {place.partition(":")[0] for place in one.missed} >= {"difffric_watch.vhd"}
