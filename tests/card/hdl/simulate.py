"""What a test needs that simulates or synthesizes the core: the tools, or why it has none."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import pytest
from cocotb_tools.runner import get_runner
from find_libpython import find_libpython

from fpga import generate

ROOT = Path(__file__).parents[3]
HDL = ROOT / "fpga" / "hdl"
CORE = generate.load()["clip"]
SOURCES = [HDL / name for name in reversed(CORE["files"])]  # what a file needs stands before it
TOP = CORE["name"]
CORE_TESTS = "tests.card.hdl.core_tests,tests.card.hdl.control_tests"


def needs(*tools: str) -> pytest.MarkDecorator:
    """Skips a test where a tool is missing, and says what to install."""
    packages = {"ghdl": "ghdl-mcode", "gcov": "gcc"}
    missing = [packages.get(tool, tool) for tool in tools if shutil.which(tool) is None]
    reason = f"not installed (on Debian: apt-get install {' '.join(missing)})"
    if not missing and find_libpython() is None:
        reason = "no simulator can load this Python: it was built without its shared library"
    return pytest.mark.skipif(bool(missing) or find_libpython() is None, reason=reason)


def call(
    *command: str | os.PathLike,
    folder: Path,
    both: bool = True,
    environment: Mapping[str, str] | None = None,
) -> str:
    """What a tool prints, without its warnings unless `both`. Raises `RuntimeError` with all of its
    words where it fails."""
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=300,
        env={**os.environ, **(environment or {})},
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}:\n{done.stdout}{done.stderr}")
    return done.stdout + (done.stderr if both else "")


def run(
    modules: str,
    folder: Path,
    *,
    sources: list[Path] = SOURCES,
    built: bool = False,
    environment: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Why each cocotb test of `modules` failed, empty where it did not, all in one simulation.

    Under GHDL, or Icarus where the sources are Verilog. `built`: `folder` has it compiled already.
    """
    vhdl = sources[0].suffix == ".vhd"
    runner = get_runner("ghdl" if vhdl else "icarus")
    where = {"build_dir": folder, "hdl_toplevel": TOP}
    log, results = folder / "simulation.txt", folder / "results.xml"
    try:
        if not built:
            scale = None if vhdl else ("1ns", "1ps")
            runner.build(sources=sources, timescale=scale, always=True, log_file=log, **where)
        runner.test(
            test_module=modules,
            hdl_toplevel_library="top",
            hdl_toplevel_lang="vhdl" if vhdl else "verilog",
            test_dir=folder,
            results_xml=str(results),
            log_file=log,
            extra_env={"PYTHONPATH": str(ROOT), **(environment or {})},
            **where,
        )
    except (SystemExit, RuntimeError) as error:
        if not results.exists():  # else it only says that a test failed, and which is told below
            words = log.read_text(encoding="utf-8")[-5000:] if log.exists() else ""
            raise RuntimeError(f"{error}:\n{words}") from None
    return {
        case.attrib["name"]: "".join(
            f"{found.attrib.get('message', '')}\n{found.text or ''}"
            for found in (*case.findall("failure"), *case.findall("error"))
        )
        for case in ElementTree.parse(results).iter("testcase")
    }
