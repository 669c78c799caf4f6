#!/bin/bash
# Instructions that an aarch64 program executes, counted in emulation, of the functions whose names begin with PREFIX: one line a function and mnemonic, `FUNCTION MNEMONIC COUNT`, and `FUNCTION calls COUNT`,
# `FUNCTION instructions COUNT`. The program's own output goes to standard error. 77 if the tools are not there.
# COUNT_BY=address: by the instruction's address instead of its mnemonic.
#   tests/count.sh PREFIX PROGRAM [ARGUMENT]...
set -eu
for tool in qemu-aarch64 gcc; do command -v $tool >/dev/null || { echo "count: skipped, no $tool" >&2; exit 77; }; done
W=$(mktemp -d)
trap 'rm -rf "$W"' EXIT
gcc -O2 -shared -fPIC -o "$W/count.so" "$(dirname "$0")/plugin/count.c"
qemu-aarch64 -cpu max -plugin "$W/count.so,out=$W/rows,name=$1${COUNT_BY:+,by=$COUNT_BY}" "${@:2}" >&2
awk '{ print } $2 != "calls" { sum[$1] += $3 } END { for (f in sum) print f, "instructions", sum[f] }' "$W/rows" | sort -k1,1 -k3,3nr
