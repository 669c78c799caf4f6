#!/bin/bash
# Installs what Oriel needs, Debian packages by name, as root or through sudo. Does nothing when all are there.
# The arm64 libraries of the board builds are unpacked into build/sysroot, not installed: installed they would drive out the native ones.
set -eu
packages=(gcc g++ clang make pkg-config libopenimageio-dev libopenexr-dev libcmocka-dev libjpeg62-turbo-dev libpng-dev zlib1g-dev
          gcc-aarch64-linux-gnu libc6-dev-arm64-cross gcc-arm-linux-gnueabihf libc6-dev-armhf-cross qemu-user-static ffmpeg openimageio-tools libclang-rt-14-dev
          libopenmpi-dev openmpi-bin libxnnpack-dev libpthreadpool-dev qemu-user llvm)
arm64=(libjpeg62-turbo libjpeg62-turbo-dev libpng16-16 libpng-dev zlib1g zlib1g-dev)
root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }

missing=()
for p in "${packages[@]}"; do
    dpkg-query -W -f='${Status}' "$p" 2>/dev/null | grep -q 'install ok installed' || missing+=("$p")
done
updated=0
if [ ${#missing[@]} -gt 0 ]; then
    echo "installing ${missing[*]}"
    root apt-get update -qq
    updated=1
    DEBIAN_FRONTEND=noninteractive root apt-get install -y -qq --no-install-recommends "${missing[@]}"
fi

sysroot=build/sysroot
if [ ! -f $sysroot/.complete ]; then
    mkdir -p $sysroot/.deb
    if ! dpkg --print-foreign-architectures | grep -q arm64; then root dpkg --add-architecture arm64; updated=0; fi
    [ $updated = 1 ] || root apt-get update -qq
    if (cd $sysroot/.deb && apt-get download -qq "${arm64[@]/%/:arm64}" 2>/dev/null); then
        for deb in $sysroot/.deb/*.deb; do dpkg-deb -x "$deb" $sysroot; done
        touch $sysroot/.complete
    else
        echo "arm64 packages cannot be fetched: board builds go without JPEG and PNG"
    fi
    rm -rf $sysroot/.deb
fi
