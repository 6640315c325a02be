#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# make arm64: the wheel, tests/c, tests/rt and tests/unit on aarch64, in a Debian 12 of that
# architecture whose programs QEMU runs. Arguments go to pytest. Without root, Debian 12 or the
# packages it prints the reason in one line and ends with status 0.
# In the emulation results are valid, but times mean nothing.
set -euo pipefail

here=$(dirname "$(realpath "$0")")
project=$(realpath "$here/../..")
dir=$project/build/arm64
python=$project/.venv/bin/python
guest=(python3 python3-dev python3-venv gcc libc6-dev make git)
tests=(tests/unit tests/rt tests/golden)
[ "$#" = 0 ] || tests=("$@")

say() { echo "arm64: $*, $SECONDS s" >&2; }
skip() { echo "make arm64: skipped: $*" >&2; exit 0; }

[ "$(id -u)" = 0 ] || skip "needs root, to make a file system of Debian packages"
grep -q VERSION_CODENAME=bookworm /etc/os-release || skip "needs Debian 12"
for program in qemu-aarch64-static mmdebstrap arch-test; do
    command -v "$program" >/dev/null ||
        skip "needs $program (apt install qemu-user-static mmdebstrap arch-test)"
done

# The kernel runs programs of aarch64 with QEMU. Flag F opens QEMU now, so that the guest need not
# contain it (binfmt-misc.rst).
handler=/proc/sys/fs/binfmt_misc/qemu-aarch64
if [ ! -e "$handler" ]; then
    mountpoint -q /proc/sys/fs/binfmt_misc || mount -t binfmt_misc none /proc/sys/fs/binfmt_misc ||
        skip "needs binfmt_misc in the kernel"
    machine='\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00'
    mask='\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff'
    echo ":qemu-aarch64:M::$machine:$mask:$(command -v qemu-aarch64-static):F" \
        >/proc/sys/fs/binfmt_misc/register
fi

mkdir -p "$dir/wheels"
"$python" "$here/wheels.py" "$dir/wheels"
say "wheels are there"
if [ ! -e "$dir/made" ]; then
    rm -rf "$dir/tree"
    mmdebstrap --architectures=arm64 --variant=minbase --mode=root --quiet \
        --include="$(IFS=,; echo "${guest[*]}")" \
        --aptopt='Acquire::Languages "none"' --dpkgopt=force-unsafe-io \
        --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/man/*' \
        --dpkgopt='path-exclude=/usr/share/locale/*' bookworm "$dir/tree"
    touch "$dir/made"
    say "Debian is there"
fi

inside() {
    chroot "$dir/tree" /usr/bin/env -i \
        PATH=/usr/bin:/bin:/usr/sbin:/sbin HOME=/tmp LC_ALL=C.UTF-8 "$@"
}
trap 'umount -l "$dir/tree"/{proc,dev} 2>/dev/null || true' EXIT
mount -t proc none "$dir/tree/proc"
mount --rbind /dev "$dir/tree/dev"
mount --make-rslave "$dir/tree/dev"

rm -rf "$dir/tree/motord" "$dir/tree/wheels"
mkdir "$dir/tree/motord"
git -C "$project" ls-files -z --cached --others --exclude-standard |
    tar -C "$project" --null -T - -cf - | tar -C "$dir/tree/motord" -xf -
cp -r "$dir/wheels" "$dir/tree/wheels"
cp "$here/inside.sh" "$dir/tree/inside.sh"
inside bash /inside.sh "${tests[@]}"
say "done"
