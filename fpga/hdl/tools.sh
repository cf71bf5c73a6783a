#!/bin/sh
# The tools that the tests of the VHDL need beside .venv, from Debian's packages, where that may be
# done: as root, or by a sudo that asks for no password. Elsewhere those tests are skipped. Says in
# a line what is missing; never fails.

missing() {
    for tool in ghdl:ghdl-mcode ghdl-gcc:ghdl-gcc yosys:yosys iverilog:iverilog; do
        command -v "${tool%%:*}" >/dev/null 2>&1 || printf ' %s' "${tool#*:}"
    done
}

# No list of packages yet is the usual reason why the first try fails.
install() {
    options="-y -qq --no-install-recommends -o DPkg::Lock::Timeout=60 -o Acquire::Retries=1"
    options="$options -o Acquire::http::Timeout=15"
    # shellcheck disable=SC2086
    timeout 300 $1 apt-get $options install $(missing) ||
        { timeout 60 $1 apt-get $options update && timeout 300 $1 apt-get $options install $(missing); }
}

if [ -n "$(missing)" ] && command -v apt-get >/dev/null 2>&1; then
    export DEBIAN_FRONTEND=noninteractive
    if [ "$(id -u)" -eq 0 ]; then
        install "" >/dev/null 2>&1
    elif sudo -n true >/dev/null 2>&1; then
        install "sudo -n" >/dev/null 2>&1
    fi
fi
if [ -n "$(missing)" ]; then
    echo "make test: not installed:$(missing): some tests of the VHDL are skipped" >&2
fi
exit 0
