#!/bin/bash
# Every kernel - re-lighting, int8 networks, the march; conversion of camera formats - has one hash here, on emulated aarch64 with and without dot product, and on emulated armhf. $1: build folder.
set -e
B=${1:-build/host}
for tool in aarch64-linux-gnu-gcc qemu-aarch64-static; do
    command -v $tool >/dev/null || { echo "kernels_arm: skipped, no $tool"; exit 77; }
done
hashes() { # TOOL VARIANT...: these variants must have run
    local tool=$1 all cpu name
    make -s BOARD=rpi4 CC=aarch64-linux-gnu-gcc SAN= build/rpi4/tools/$tool
    all=$("$B/tools/$tool")
    for cpu in cortex-a72 max; do
        all+=$'\n'$(QEMU_LD_PREFIX=/usr/aarch64-linux-gnu QEMU_CPU=$cpu qemu-aarch64-static build/rpi4/tools/$tool | sed "s/\$/ ($cpu)/")
    done
    if command -v arm-linux-gnueabihf-gcc >/dev/null && command -v qemu-arm-static >/dev/null; then
        make -s BOARD=armhf CC=arm-linux-gnueabihf-gcc SAN= build/armhf/tools/$tool
        all+=$'\n'$(qemu-arm-static build/armhf/tools/$tool | sed "s/\$/ (armhf)/")
    fi
    echo "$all"
    for name in "${@:2}"; do echo "$all" | grep -q "$name" || { echo "kernels_arm: $tool: $name did not run"; exit 1; }; done
    [ "$(echo "$all" | cut -d' ' -f1 | sort -u | wc -l)" = 1 ] || { echo "kernels_arm: $tool: hashes differ"; exit 1; }
}
hashes kernel_hash neon dotprod
hashes convert_hash neon
