#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# roots.sh [--demo] [SUITE...]: runs the README's two commands as a new user does, in bare roots of
# Debian 12 (Python 3.11) and 13 (Python 3.13): `make demo`, the packages that it names, `make demo`
# again, `make test`. --demo: without `make test`. Needs root. A root is made once, in build/roots.
set -euo pipefail
cd "$(dirname "$0")/.."

tests=1
[ "${1:-}" != --demo ] || { tests=0; shift; }
suites=("${@:-bookworm}")
[ $# -gt 0 ] || suites=(bookworm trixie)

[ "$(id -u)" = 0 ] || { echo "make roots: skipped: needs root" >&2; exit 0; }
if ! command -v mmdebstrap >/dev/null; then
    echo "make roots: skipped: needs mmdebstrap (apt install mmdebstrap)" >&2
    exit 0
fi

make_root() { # SUITE ROOT
    mkdir -p build/roots
    rm -rf "$2"
    mmdebstrap --variant=apt --mode=root --quiet --include=ca-certificates,git,make \
        "$1" "$2.new" </dev/null
    # The host may trust a registry that Debian does not know.
    cp /etc/ssl/certs/ca-certificates.crt "$2.new/etc/ssl/certs/"
    cp /etc/resolv.conf "$2.new/etc/"
    mv "$2.new" "$2"
}

# Everything in it ends with its first process. `--mount`: what it mounts is its own.
inside() { # ROOT COMMAND...
    unshare --mount --pid --fork --kill-child bash -euc '
        mount --bind "$1" "$1"
        mount -t proc proc "$1/proc"
        mount --rbind /sys "$1/sys"
        mount --rbind /dev "$1/dev"
        exec chroot "$1" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8 \
            PIP_CERT=/etc/ssl/certs/ca-certificates.crt DEBIAN_FRONTEND=noninteractive \
            bash -euc "cd /motord && $2"' inside "$@"
}

try() { # SUITE
    local root=build/roots/$1 named
    [ -d "$root" ] || make_root "$1" "$root"
    rm -rf "$root/motord"
    git clone --quiet . "$root/motord"
    echo "$1: $(inside "$root" 'python3 --version 2>/dev/null || echo no Python yet')"
    if ! named=$(inside "$root" 'make demo ARGS="--seconds 12"' 2>&1); then
        named=$(sed -n 's/^ *sudo \(apt install .*\)/\1/p' <<<"$named")
        [ -n "$named" ] || { echo "$1: make demo names no packages" >&2; return 1; }
        echo "$1: $named"
        named=${named/apt install/apt-get install -y -qq}
        inside "$root" "apt-get update -qq && $named >/dev/null"
        inside "$root" 'make demo ARGS="--seconds 12"'
    fi
    [ "$tests" = 0 ] || inside "$root" 'make test'
    echo "$1: passed, $SECONDS s"
}

for suite in "${suites[@]}"; do
    try "$suite"
done
