#!/bin/sh
# Re-lighting kernels, int8 networks and the march: one hash here, on emulated aarch64 with and without dot product, and on emulated armhf. $1: build folder.
set -e
B=${1:-build/host}
for tool in aarch64-linux-gnu-gcc qemu-aarch64-static; do
    command -v $tool >/dev/null || { echo "kernels_arm: skipped, no $tool"; exit 77; }
done
make -s BOARD=rpi4 CC=aarch64-linux-gnu-gcc SAN= build/rpi4/tools/kernel_hash
all=$("$B/tools/kernel_hash")
for cpu in cortex-a72 max; do
    all="$all
$(QEMU_LD_PREFIX=/usr/aarch64-linux-gnu QEMU_CPU=$cpu qemu-aarch64-static build/rpi4/tools/kernel_hash | sed "s/\$/ ($cpu)/")"
done
if command -v arm-linux-gnueabihf-gcc >/dev/null && command -v qemu-arm-static >/dev/null; then
    make -s BOARD=armhf CC=arm-linux-gnueabihf-gcc SAN= build/armhf/tools/kernel_hash
    all="$all
$(qemu-arm-static build/armhf/tools/kernel_hash | sed "s/\$/ (armhf)/")"
fi
echo "$all"
echo "$all" | grep -q neon && echo "$all" | grep -q dotprod || { echo "kernels_arm: a variant did not run"; exit 1; }
[ "$(echo "$all" | cut -d' ' -f1 | sort -u | wc -l)" = 1 ] || { echo "kernels_arm: hashes differ"; exit 1; }
