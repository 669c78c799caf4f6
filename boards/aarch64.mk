# What the aarch64 boards share: Debian's cross compiler, static programs, libraries from the unpacked sysroot where it is there (make deps).
ARCH := aarch64
CC := aarch64-linux-gnu-gcc
CXX := aarch64-linux-gnu-g++
LDFLAGS := -static
SYSROOT := build/sysroot
PKG := PKG_CONFIG_SYSROOT_DIR=$(SYSROOT) PKG_CONFIG_LIBDIR=$(SYSROOT)/usr/lib/aarch64-linux-gnu/pkgconfig pkg-config
CPU += -isystem $(SYSROOT)/usr/include -isystem $(SYSROOT)/usr/include/aarch64-linux-gnu
LDFLAGS += -L$(SYSROOT)/usr/lib/aarch64-linux-gnu
