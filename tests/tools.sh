#!/bin/sh
# The tools that tests need beside .venv, from Debian's packages, where that may be done: as root, or
# by a sudo that asks for no password. Elsewhere those tests are skipped. Says in a line what is
# missing; never fails.

HDL="ghdl:ghdl-mcode ghdl-gcc:ghdl-gcc yosys:yosys iverilog:iverilog"
BROWSER="chromium:chromium"

missing() {
    for tool in $1; do
        command -v "${tool%%:*}" >/dev/null 2>&1 || printf ' %s' "${tool#*:}"
    done
}

# No list of packages yet is the usual reason why the first try fails.
install() {
    options="-y -qq --no-install-recommends -o DPkg::Lock::Timeout=60 -o Acquire::Retries=1"
    options="$options -o Acquire::http::Timeout=15"
    # shellcheck disable=SC2086
    timeout 300 $2 apt-get $options install $1 ||
        { timeout 60 $2 apt-get $options update && timeout 300 $2 apt-get $options install $1; }
}

# Each group by itself: one that cannot be had is not to keep the other away.
provide() {
    packages=$(missing "$1")
    [ -n "$packages" ] && command -v apt-get >/dev/null 2>&1 || return
    export DEBIAN_FRONTEND=noninteractive
    if [ "$(id -u)" -eq 0 ]; then
        install "$packages" "" >/dev/null 2>&1
    elif sudo -n true >/dev/null 2>&1; then
        install "$packages" "sudo -n" >/dev/null 2>&1
    fi
}

provide "$HDL"
# Elsewhere than in Debian a package of this name is a stand-in for something else.
if grep -qx "ID=debian" /etc/os-release 2>/dev/null; then
    provide "$BROWSER"
fi

if [ -n "$(missing "$HDL")" ]; then
    echo "make test: not installed:$(missing "$HDL"): some tests of the VHDL are skipped" >&2
fi
if [ -n "$(missing "$BROWSER")" ]; then
    echo "make test: not installed:$(missing "$BROWSER"): the tests in a browser are skipped" >&2
fi
exit 0
