#!/bin/sh
# Conversion kernels: one hash here and on emulated aarch64. $1: build folder.
set -e
B=${1:-build/host}
for tool in aarch64-linux-gnu-gcc qemu-aarch64-static; do
    command -v $tool >/dev/null || { echo "convert_aarch64: skipped, no $tool"; exit 77; }
done
make -s BOARD=rpi4 CC=aarch64-linux-gnu-gcc SAN= build/rpi4/tools/convert_hash
all="$("$B/tools/convert_hash")
$(QEMU_LD_PREFIX=/usr/aarch64-linux-gnu QEMU_CPU=cortex-a72 qemu-aarch64-static build/rpi4/tools/convert_hash | sed 's/$/ (cortex-a72)/')"
echo "$all"
echo "$all" | grep -q neon || { echo "convert_aarch64: no NEON variant ran"; exit 1; }
[ "$(echo "$all" | cut -d' ' -f1 | sort -u | wc -l)" = 1 ] || { echo "convert_aarch64: hashes differ"; exit 1; }
