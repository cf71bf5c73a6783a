"""The FPGA core under a simulator: cocotb tests, which tests/card/test_hdl.py runs."""
