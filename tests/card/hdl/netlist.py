"""The core in a Xilinx FPGA's cells, and how many: `.venv/bin/python -m tests.card.hdl.netlist`."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from tests.card.hdl.simulate import SOURCES, TOP, call

SCRIPT = f"""
read_verilog {TOP}.v
hierarchy -check -top {TOP}
check -assert
synth_xilinx -top {TOP} -flatten -noiopad -noclkbuf
check -assert
tee -q -o cells.json stat -json
write_verilog -noattr netlist.v
"""


@dataclass(frozen=True)
class Netlist:
    verilog: Path
    models: Path
    """of its cells, for a simulator"""
    cells: dict[str, int]

    def count(self, *begin: str) -> int:
        """Cells whose names begin so."""
        return sum(n for name, n in self.cells.items() if name.startswith(begin))

    @property
    def luts(self) -> int:
        """Look-up tables, an inverter being one."""
        return self.count("LUT", "INV")

    @property
    def flip_flops(self) -> int:
        return self.count("FD")


def synthesized(folder: Path, sources: list[Path] = SOURCES) -> Netlist:
    """Raises `RuntimeError` for what GHDL cannot make hardware of, latches among it, and where
    yosys finds a net with two drivers, one with none, or a loop of gates."""
    for source in sources:
        call("ghdl", "-a", "--std=93", source, folder=folder)
    verilog = call("ghdl", "--synth", "--std=93", "--out=verilog", TOP, folder=folder, both=False)
    if unknown := re.findall(r".*'b[01X]*X.*", verilog):  # all that GHDL 2.0 says of some latches
        raise RuntimeError(f"a latch, or a net without a value: {unknown}")
    (folder / f"{TOP}.v").write_text(verilog, encoding="utf-8")
    call("yosys", "-q", "-p", SCRIPT, folder=folder)
    cells = json.loads((folder / "cells.json").read_text())
    of_the_top = next(found for name, found in cells["modules"].items() if name.endswith(TOP))
    yosys = Path(shutil.which("yosys") or "").resolve()
    models = yosys.parents[1] / "share" / "yosys" / "xilinx" / "cells_sim.v"
    return Netlist(folder / "netlist.v", models, of_the_top["num_cells_by_type"])


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = synthesized(Path(folder))
    print(
        f"{found.luts} LUTs, {found.flip_flops} flip-flops, {found.count('CARRY4')} CARRY4, "
        f"{found.count('MUXF')} MUXF, {found.count('LD')} latches"
    )
    print(", ".join(f"{n} {name}" for name, n in sorted(found.cells.items())))


if __name__ == "__main__":
    main()
