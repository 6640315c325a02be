#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# image.sh DIR: a Debian 12 with the PREEMPT_RT kernel for QEMU: DIR/vmlinuz, DIR/initrd.gz,
# DIR/root.ext4. Needs root. Made anew when this file, init or the unit has changed; removing DIR
# makes it anew in any case.
set -euo pipefail

here=$(dirname "$(realpath "$0")")
mkdir -p "$1"
dir=$(realpath "$1")
host=(busybox-static cpio e2fsprogs gcc kmod make mmdebstrap qemu-system-x86 xz-utils)
guest=(can-utils dbus gpiod iproute2 kmod procps python3 python3-evdev python3-pytest
    python3-pytest-asyncio python3-pytest-timeout systemd systemd-sysv udev)
early=(virtio_pci virtio_blk ext4 crc32c_generic)
late=(can can-bcm can-raw vcan vxcan slcan configfs evdev ftdi_sio i2c-dev i2c-stub kvaser_pci
    sch_netem uinput usbserial virtio_console xhci-pci)
quiet=(apt-daily.timer apt-daily-upgrade.timer dpkg-db-backup.timer e2scrub_all.timer fstrim.timer
    getty@tty1.service getty-static.service serial-getty@ttyS0.service systemd-hwdb-update.service
    systemd-logind.service systemd-timesyncd.service)

say() { echo "image: $*, $SECONDS s" >&2; }

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

newest_kernel() {
    apt-cache depends linux-image-rt-amd64 2>/dev/null |
        sed -n 's/.*Depends: linux-image-\([0-9].*\)/\1/p' | head -n 1
}

# pwm-sim is ours. Debian leaves gpio-sim out of its kernels. Its source needs irq_sim, too, which
# asks for a function that modules do not get; generic_handle_irq does the same for it.
make_modules() {
    local tree=linux-source-6.1
    mkdir modules
    (cd modules
        apt-get download -qq -o APT::Sandbox::User=root $tree
        dpkg -x $tree*.deb .
        tar -xf usr/src/$tree.tar.xz --occurrence=1 --transform='s,.*/,,' \
            $tree/drivers/gpio/gpio-sim.c $tree/drivers/gpio/gpiolib.h $tree/kernel/irq/irq_sim.c
        mv gpio-sim.c chip.c
        sed -i 's/handle_simple_irq(irq_to_desc(irqnum))/generic_handle_irq(irqnum)/' irq_sim.c
        cp "$here/pwm-sim.c" .
        printf 'obj-m := gpio-sim.o pwm-sim.o\ngpio-sim-y := chip.o irq_sim.o\n' >Kbuild
        make -s -C "/lib/modules/$kernel/build" M="$PWD" modules)
}

module_files() { # of these modules and of those that they need, in their order
    local module
    for module; do modprobe -d "$PWD/kernel" -S "$kernel" --show-depends "$module"; done |
        awk '$1 == "insmod" && !seen[$2]++ { print $2 }'
}

make_initrd() {
    local file
    mkdir -p initrd/{bin,modules,proc,sys,dev,new}
    cp /bin/busybox initrd/bin/
    install -m 755 "$here/init" initrd/init
    for file in $(module_files "${early[@]}"); do
        cp "$file" initrd/modules/
        basename "$file" >>initrd/modules/order
    done
    (cd initrd && find . | cpio -o -H newc --quiet | gzip -1 >"$dir/initrd.gz")
}

make_root() {
    local file unit modules=root/lib/modules/$kernel
    for file in $(module_files "${late[@]}"); do
        install -m 644 -D "$file" "$modules/${file##*"/$kernel/"}"
    done
    cp kernel/lib/modules/"$kernel"/modules.{builtin*,order} "$modules/"
    install -m 644 -D -t "$modules/extra" modules/{gpio,pwm}-sim.ko
    depmod -b root "$kernel"
    install -m 644 "$here/tests.service" root/etc/systemd/system/
    install -d root/etc/systemd/system/multi-user.target.wants root/project
    ln -s ../tests.service root/etc/systemd/system/multi-user.target.wants/
    for unit in "${quiet[@]}"; do ln -sf /dev/null "root/etc/systemd/system/$unit"; done
    echo guest >root/etc/hostname
    : >root/etc/fstab
    : >root/etc/machine-id
    mke2fs -q -F -t ext4 -O ^has_journal -d root "$dir/root.ext4" 800M
}

exec 9>"$dir/lock"
flock 9
mark=$(cat "$here"/{image.sh,init,tests.service,pwm-sim.c} | sha256sum)
[ "$(cat "$dir/mark" 2>/dev/null)" != "$mark" ] || exit 0
rm -rf "$dir"/{mark,work}
mkdir "$dir/work"
cd "$dir/work"
trap 'rm -rf "$dir/work"' EXIT

[ -n "$(newest_kernel)" ] || apt-get update -qq
kernel=$(newest_kernel)
install_missing "${host[@]}" "linux-headers-$kernel"
say "building with kernel $kernel"
mmdebstrap --variant=minbase --mode=root --quiet --include="$(IFS=,; echo "${guest[*]}")" \
    --aptopt='Acquire::Languages "none"' --dpkgopt=force-unsafe-io \
    --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/man/*' \
    --dpkgopt='path-exclude=/usr/share/locale/*' bookworm root &
tree=$!
apt-get download -qq -o APT::Sandbox::User=root "linux-image-$kernel"
dpkg -x linux-image-*.deb kernel
depmod -b kernel "$kernel"
cp "kernel/boot/vmlinuz-$kernel" "$dir/vmlinuz"
make_modules
make_initrd
say "kernel ready"
wait "$tree"
make_root
echo "$mark" >"$dir/mark"
say "done"
