# Raspberry Pi 4: Cortex-A72, NEON, no dot product.
CPU := -mcpu=cortex-a72
RUNNER := qemu-aarch64-static -cpu cortex-a72
include boards/aarch64.mk
