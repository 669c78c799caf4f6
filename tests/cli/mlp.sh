#!/bin/bash
# `oriel bench --mlp`: rows of this machine's variants, outputs like XNNPACK's where it is built in; instructions of the aarch64 kernels as counted in emulation. $1: build folder.
B=${1:-build/host}
. "$(dirname "$0")/common.bash"
O=$B/oriel
"$O" bench --mlp --json >"$W/rows" || fail "bench --mlp"
grep -q '"name": "int8 32-64-64-16, batch 4096 ref", "seconds": [0-9.e-]*, "gmac_s": [0-9.]*' "$W/rows" || fail "no row of ref: $(cat "$W/rows")"
if grep -q avx2 /proc/cpuinfo; then grep -q '4096 avx2", .*"ratio": [0-9.]*, "against": "peak"' "$W/rows" || fail "no share of the peak: $(cat "$W/rows")"; fi
if ldd "$O" | grep -q XNNPACK; then
    levels=$(grep -oE '"levels": [0-9]+' "$W/rows" | grep -oE '[0-9]+')
    [ "${levels:-99}" -le 3 ] || fail "outputs off XNNPACK's by ${levels:-?} levels"
    grep -q 'xnnpack_ratio' "$W/rows" || fail "not beside XNNPACK"
fi
if command -v python3 >/dev/null; then python3 -c 'import json, sys; [json.loads(l) for l in sys.stdin]' <"$W/rows" || fail "bench --mlp --json is not JSON"; fi
expect 2 "wanted are --view, or both" "$O" bench --mlp --view x

tests/boards.sh --json >"$W/boards" 2>"$W/err"
case $? in
    0) for want in neon:3.2 dotprod:8.5; do
           got=$(grep "${want%:*}, counted" "$W/boards" | grep -oE '"macs_an_instruction": [0-9.]+' | grep -oE '[0-9.]+$')
           awk -v got="${got:-0}" -v least="${want#*:}" 'BEGIN { exit !(got >= least) }' || fail "${want%:*}: ${got:-no} multiply-adds an instruction, not ${want#*:}"
       done ;;
    77) cat "$W/err" ;;
    *) fail "boards.sh: $(tail -3 "$W/err")" ;;
esac
exit $bad
