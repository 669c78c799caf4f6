#!/bin/sh
# Replays the stored corpus through the Radiance reader's fuzz target: whole, cut, changed. $1: build folder.
set -e
B=${1:-build/host}
case $B in *-san) san="-fsanitize=address,undefined -fno-sanitize-recover=undefined" ;; esac
mkdir -p "$B/tests"
${CC:-cc} -std=c11 -D_GNU_SOURCE -O1 -g $san -DFUZZ_MAIN -Iinclude -I. -o "$B/tests/fuzz_hdr" tests/fuzz/fuzz_hdr.c "$B/liboriel.a" -lpthread -lm
"$B/tests/fuzz_hdr" tests/fuzz/corpus/hdr/*
