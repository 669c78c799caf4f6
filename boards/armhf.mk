# Any 32-bit ARM of Debian's armhf (ARMv7, VFPv3): the reference kernels. Static, without image libraries: Y4M and hash.
ARCH := arm
CC := arm-linux-gnueabihf-gcc
CXX := arm-linux-gnueabihf-g++
LDFLAGS := -static
PKG := false
RUNNER := qemu-arm-static
