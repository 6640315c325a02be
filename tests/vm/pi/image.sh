#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# image.sh DIR PROJECT: a Raspberry Pi 3 for QEMU with Debian's kernel and Python: DIR/vmlinuz,
# DIR/pi.dtb and DIR/initrd.gz, which has the project's hardware layer and core in it,
# cross-compiled. Needs root.
set -euo pipefail

here=$(dirname "$(realpath "$0")")
mkdir -p "$1"
dir=$(realpath "$1")
project=$(realpath "$2")
host=(cpio gcc-aarch64-linux-gnu kmod libc6-dev-arm64-cross mmdebstrap qemu-system-arm)
guest=(base-files busybox-static coreutils dash libc-bin libpython3.11-dev linux-image-rt-arm64
    python3 python3-cffi-backend python3-pytest python3-pytest-asyncio python3-pytest-timeout)

say() { echo "pi: $*, $SECONDS s" >&2; }

install_missing() {
    local package missing=()
    for package; do
        dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'install ok installed' ||
            missing+=("$package")
    done
    [ "${#missing[@]}" = 0 ] || DEBIAN_FRONTEND=noninteractive \
        apt-get install -y -qq --no-install-recommends -o DPkg::Lock::Timeout=300 \
        "${missing[@]}" >/dev/null
}

# Packages are unpacked only: none of their scripts is run, no arm64 program is needed here.
unpack() {
    mmdebstrap --variant=extract --mode=root --quiet --architectures=arm64 \
        --include="$(IFS=,; echo "${guest[*]}")" \
        --aptopt='Acquire::Languages "none"' --dpkgopt=force-unsafe-io bookworm tree
}

take_kernel() {
    local file version
    version=$(basename tree/lib/modules/*)
    depmod -b tree "$version"
    cp "tree/boot/vmlinuz-$version" vmlinuz
    cp "tree/usr/lib/linux-image-$version/broadcom/bcm2837-rpi-3-b.dtb" pi.dtb
    mkdir modules
    for file in $(modprobe -d "$PWD/tree" -S "$version" --show-depends pwm-bcm2835 |
        awk '$1 == "insmod" { print $2 }'); do
        cp "$file" modules/
        basename "$file" >>modules/order
    done
}

# libgpiod 2 with its Python: Debian 12 has the first.
take_library() {
    local python=$project/.venv/bin/python
    "$python" -m pip download --quiet --no-deps --dest wheels \
        --only-binary=:all: --python-version 3.11 \
        --platform manylinux_2_17_aarch64 --platform manylinux2014_aarch64 gpiod >&2
    "$python" -m zipfile -e wheels/gpiod-*.whl tree/usr/lib/python3/dist-packages
    rm -r wheels
}

# The headers are needed for compiling, not there.
trim() {
    mv tree/usr/include include
    rm -rf tree/{boot,lib/modules} tree/usr/lib/linux-image-* \
        tree/usr/share/{doc,man,locale,info,i18n,zoneinfo} \
        tree/usr/lib/aarch64-linux-gnu/*.a tree/usr/lib/python3.11/config-* \
        tree/var/lib/{apt,dpkg} tree/var/cache/apt
    mv modules tree/
    ln -sf dash tree/bin/sh
    install -m 755 "$here/init" tree/init
    (cd tree && find . | cpio -o -H newc --quiet | gzip -1) >base.gz
    rm -rf tree
}

# The configuration's reader stays here: the line gets a drive's profile made, as it does in the
# daemon.
make_profile() {
    "$project/.venv/bin/python" - "$1" >"$2" <<'CODE'
import pickle, sys
from motord.config.drives.load import find_profile
pickle.dump(find_profile(sys.argv[1]), sys.stdout.buffer)
CODE
}

compile_core() {
    "$project/.venv/bin/python" - "$project" "$1" >&2 <<'CODE'
import os, sys
sys.path.insert(0, os.path.join(sys.argv[1], "csrc"))
os.chdir(sys.argv[1])
from build_ffi import ffi
ffi.emit_c_code(sys.argv[2])
CODE
    aarch64-linux-gnu-gcc -std=c11 -O2 -ffp-contract=off -D_GNU_SOURCE -fPIC -shared \
        $(find "$project/csrc" -type d -printf '-I %p ') -I include -I include/python3.11 "$1" \
        $(find "$project/csrc" -name '*.c' -not -path '*/bus/*') -lm -o "$2"
}

add_project() {
    local to=$1/project
    mkdir -p "$to"
    cp -r "$project/hal/motord_hal" "$to/"
    cp "$here"/{conftest,test_pins,rig}.py "$here/../guest/pytest.ini" \
        "$project/tests/contract/loop_side.py" "$to/"
    make_profile bts7960 "$to/bts7960.pickle"
    compile_core "$1/motord_rt.c" "$to/_motord_rt.abi3.so"
    rm "$1/motord_rt.c"
    (cd "$1" && find project | cpio -o -H newc --quiet | gzip -1)
}

apt-cache show gcc-aarch64-linux-gnu >/dev/null 2>&1 || apt-get update -qq
install_missing "${host[@]}"
mark=$(cat "$here"/{image.sh,init} | sha256sum)
cd "$dir"
if [ "$(cat mark 2>/dev/null)" != "$mark" ]; then
    rm -rf ./*
    unpack
    take_kernel
    take_library
    trim
    echo "$mark" >mark
    say "kernel and packages ready"
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
add_project "$work" >project.gz
cat base.gz project.gz >initrd.gz
say "done"
