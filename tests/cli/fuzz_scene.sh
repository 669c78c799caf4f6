#!/bin/sh
# Replays the stored corpus through the scene reader's fuzz target. $1: build folder.
set -e
B=${1:-build/host}
case $B in *-san) san="-fsanitize=address,undefined -fno-sanitize-recover=undefined" ;; esac
mkdir -p "$B/tests"
${CC:-cc} -std=c11 -D_GNU_SOURCE -O1 -g $san -Iinclude -I. -o "$B/tests/fuzz_scene" tests/fuzz/fuzz_scene.c "$B/liboriel.a" -lpthread -lm
"$B/tests/fuzz_scene" tests/fuzz/corpus/scene
