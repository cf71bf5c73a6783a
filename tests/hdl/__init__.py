"""The FPGA core under a simulator: cocotb tests, which tests/test_hdl.py runs."""
