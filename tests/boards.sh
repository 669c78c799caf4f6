#!/bin/bash
# What boards that are not here would take: instructions counted in emulation, cycles as llvm-mca estimates them of the instructions that run, without stalls of memory. First the re-lighting and conversion kernels
# and what follows for whole pictures, then the int8 network beside its dot product alone. --json: one object a row.
#   tests/boards.sh [--json]
set -eu
json=0; [ "${1:-}" = --json ] && json=1
for tool in qemu-aarch64 aarch64-linux-gnu-gcc aarch64-linux-gnu-objdump llvm-mca; do command -v $tool >/dev/null || { echo "boards: skipped, no $tool" >&2; exit 77; }; done
make -s BOARD=rpi4 CC=aarch64-linux-gnu-gcc SAN= build/rpi4/oriel build/rpi4/tools/kernel_work >&2
W=$(mktemp -d)
trap 'rm -rf "$W"' EXIT

# ---- re-lighting and conversion

# The instructions of a function in the order in which they stand, each as often as one turn runs it, from counts by address, for llvm-mca: FUNCTION TURNS
path() {
    aarch64-linux-gnu-objdump -d --no-show-raw-insn build/rpi4/tools/kernel_work | awk -v name="$1" -v turns="$2" '
        NR == FNR { if ($1 == name) count[$2] = $3; next }
        /^ *[0-9a-f]+:\t/ {
            split($0, f, "\t"); sub(/^ */, "", f[1]); sub(/:.*/, "", f[1])
            times = f[1] in count ? int(count[f[1]] / turns + 0.5) : 0
            if (times != last) { put(); n = 0; last = times }
            sub(/ *\/\/.*/, "", f[3]); sub(/ <.*/, "", f[3])
            if (f[2] ~ /^(b|bl|b\..*|cbz|cbnz|tbz|tbnz|adrp)$/) sub(/[0-9a-f]+$/, "#4096", f[3])       # places that only the linker knows
            if (times) text[++n] = f[2] "\t" f[3]
        }
        function put(  i, k) { for (k = 0; k < last; k++) for (i = 1; i <= n; i++) print text[i] }
        END { put() }' "$W/addresses" -
}

cycles() { llvm-mca -mtriple=aarch64-linux-gnu -mcpu="$1" -mattr=+dotprod -iterations=100 "$2" | awk '/^Total Cycles:/ { print $3 / 100 }'; }

kernel_row() { # KERNEL VARIANT PLACE INSTRUCTIONS BYTES [CPU CYCLES]...: of a pixel
    local name=$1 variant=$2 place=$3 instructions=$4 bytes=$5
    shift 5
    if [ $json = 1 ]; then
        printf '{"name": "%s %s, %s", "instructions_a_pixel": %.2f, "bytes_a_pixel": %.4g' "$name" "$variant" "$place" "$instructions" "$bytes"
        while [ $# -gt 0 ]; do printf ', "%s_cycles_a_pixel_estimate": %.2f' "${1//-/_}" "$2"; shift 2; done
        echo '}'
    else
        printf '%-14s %-8s %-8s %6.2f instructions, %5.1f bytes a pixel; cycles, estimated:' "$name" "$variant" "$place" "$instructions" "$bytes"
        while [ $# -gt 0 ]; do printf '  %s %.2f' "$1" "$2"; shift 2; done
        echo
    fi
}

# kernel place pixels turn bytes instructions a53 a72 a76, a line each, into FILE
: >"$W/kernels"
for variant in neon dotprod; do
    for place in surface sky border; do
        tests/count.sh orl_ build/rpi4/tools/kernel_work $variant $place >"$W/counts" 2>"$W/work"
        COUNT_BY=address tests/count.sh orl_ build/rpi4/tools/kernel_work $variant $place >"$W/addresses" 2>/dev/null
        while read -r kernel pixels turn bytes; do
            case $place-$kernel in
                sky-mix | sky-warp | border-warp | border-vis | border-shadow | sky-convert* | border-convert*) continue ;;      # as on a surface
            esac
            f=orl_${kernel}_$variant
            total=$(awk -v f="$f" '$1 == f && $2 == "instructions" { print $3 }' "$W/counts")
            [ -n "$total" ] || continue                     # the conversion has no kernels with dot product
            path "$f" $((pixels / turn)) >"$W/path"
            row=("${kernel/_/ }" "$variant" "$place" "$(awk "BEGIN { print $total / $pixels }")" "$bytes")
            all="$kernel $variant $place"
            for cpu in cortex-a53 cortex-a72 cortex-a76; do
                [ "$variant-$cpu" = dotprod-cortex-a53 ] || [ "$variant-$cpu" = dotprod-cortex-a72 ] && { all="$all nan"; continue; }
                c=$(awk "BEGIN { print $(cycles $cpu "$W/path") / $turn }")
                row+=($cpu "$c")
                all="$all $c"
            done
            kernel_row "${row[@]}"
            echo "$all" >>"$W/kernels"
        done <"$W/work"
    done
done

# Milliseconds of a picture whose every pixel has a surface: vis, shadow and shade of all, mix of all, warp of what the photo covers at 2.2 times the wide view's field (1 / 2.2^2), and YUYV of as many pixels converted.
for board in "Raspberry Pi 4, 1.5 GHz:neon:5:1500" "Raspberry Pi 5, 2.4 GHz:dotprod:6:2400"; do
    IFS=: read -r name variant column mhz <<<"$board"
    for size in 640x480 1920x1080; do
        awk -v variant=$variant -v column=$column -v mhz=$mhz -v pixels=$((${size%x*} * ${size#*x})) -v json=$json -v name="$name" -v size=$size '
            $3 == "surface" && ($2 == variant || $1 ~ /^convert/) { c[$1] = $column }
            END {
                ms = pixels / mhz / 1000
                light = ms * (c["vis"] + c["shadow"] + c["shade"]); blend = ms * (c["mix"] + c["warp"] / 4.84); convert = ms * c["convert_yuyv"]
                if (json) printf "{\"name\": \"%s, a picture of %s, estimate without stalls\", \"shade_seconds\": %.4g, \"blend_seconds\": %.4g, \"convert_seconds\": %.4g}\n", name, size, light / 1000, blend / 1000, convert / 1000
                else printf "%-24s %-10s estimated without stalls: shade %.1f ms, blend %.1f ms, convert %.1f ms\n", name, size, light, blend, convert
            }' "$W/kernels"
    done
done

# ---- the int8 network

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
