# Raspberry Pi 5: Cortex-A76, NEON with dot product.
CPU := -mcpu=cortex-a76
RUNNER := qemu-aarch64-static -cpu max
include boards/aarch64.mk
