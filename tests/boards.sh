#!/bin/bash
# What the int8 network costs on boards that are not here: instructions counted in emulation, cycles of its hot loop as llvm-mca estimates them; both beside the dot product alone. --json: one object a row.
#   tests/boards.sh [--json]
set -eu
json=0; [ "${1:-}" = --json ] && json=1
for tool in qemu-aarch64 aarch64-linux-gnu-gcc aarch64-linux-gnu-objdump llvm-mca; do command -v $tool >/dev/null || { echo "boards: skipped, no $tool" >&2; exit 77; }; done
make -s BOARD=rpi4 CC=aarch64-linux-gnu-gcc SAN= build/rpi4/oriel >&2
W=$(mktemp -d)
trap 'rm -rf "$W"' EXIT
macs=$((4096 * (32 * 64 + 64 * 64 + 64 * 16)))

row() { # VARIANT WHAT KEY VALUE IDEAL
    if [ $json = 1 ]; then echo "{\"name\": \"int8 32-64-64-16 $1, $2\", \"$3\": $4, \"ideal\": $5}"
    else printf '%-28s %-8s %-20s %6.2f %s, %6.2f in the dot product alone\n' "int8 32-64-64-16" "$1" "$2" "$4" "${3//_/ }" "$5"; fi
}

# The innermost loop of a function that holds the most dot products; their number (16 multiply-adds each, smull and smlal2 being one) goes to FILE.n
loop() { # VARIANT FUNCTION FILE
    aarch64-linux-gnu-objdump -d --no-show-raw-insn "build/rpi4/obj/runtime/kernels/mlp_$1.o" | awk -v name="<$2>:" -v count="$3.n" '
        / <.*>:$/ { inside = index($0, name) }
        inside && /^ *[0-9a-f]+:\t/ {
            split($0, f, "\t"); sub(/^ */, "", f[1]); sub(/:.*/, "", f[1]); sub(/ *\/\/.*/, "", f[3])
            at[f[1]] = ++n; op[n] = f[2]; arg[n] = f[3]
            if (f[2] ~ /^(b|b\..*|cbz|cbnz|tbz|tbnz)$/) { sub(/ <.*/, "", f[3]); sub(/.*[ ,]/, "", f[3]); to[n] = f[3] }
        }
        END {
            for (i in to) {
                if (!(to[i] in at) || at[to[i]] >= i + 0) continue
                dots = 0
                for (j = at[to[i]]; j < i + 0; j++) { if (j in to) dots = -1000; if (op[j] ~ /^(sdot|smull)$/) dots++ }
                if (dots > most || dots == most && i + 0 < end) { most = dots; from = at[to[i]]; end = i + 0 }
            }
            for (j = from; j < end; j++) print op[j] "\t" arg[j]
            print most > count
        }' >"$3"
}

estimate() { # FILE CPU: multiply-adds a cycle
    llvm-mca -mtriple=aarch64-linux-gnu -mcpu="$2" -mattr=+dotprod -iterations=200 "$1" | awk -v dots="$(cat "$1.n")" '/^Total Cycles:/ { printf "%.2f", dots * 16 * 200 / $3 }'
}

tests/count.sh run_ build/rpi4/oriel bench --mlp >"$W/counts" 2>/dev/null
for variant in neon:5.333:a53,a72,a76 dotprod:16:a76; do
    IFS=: read -r name ideal cpus <<<"$variant"
    row "$name" "counted" macs_an_instruction "$(awk -v f="run_$name" -v macs=$macs '$1 == f && $2 == "calls" { c = $3 } $1 == f && $2 == "instructions" { n = $3 } END { printf "%.2f", macs * c / n }' "$W/counts")" "$ideal"
    loop "$name" "run_$name" "$W/run"
    loop "$name" "peak_$name" "$W/peak"
    for cpu in ${cpus//,/ }; do row "$name" "cortex-$cpu, estimate" macs_a_cycle "$(estimate "$W/run" "cortex-$cpu")" "$(estimate "$W/peak" "cortex-$cpu")"; done
done
