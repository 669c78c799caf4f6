#!/bin/bash
# Memory of a fit by number of photos: between 20 and 60 small photos it must grow by less than 64 bytes a pixel. Stereo takes 46 of them (and only up to its bound), plain pixels 3.25, transients 2.
# $1: build folder.
set -u
B=${1:-build/host}
case $B in *-san) echo "growth.sh: skipped, the sanitiser's memory is not ours"; exit 77 ;; esac
W=$(mktemp -d)
trap 'rm -rf "$W"' EXIT
"$B/tools/attraction" --photos=6 --tests=1 --width=96 --frames=0 --points=800 "$W/place" >/dev/null || exit 1
for n in 20 60; do
    "$B/tools/crowd" "$W/place" $n 192 "$W/$n" >/dev/null || exit 1
    "$B/oriel-train" fit "$W/$n" -o "$W/$n.oriel" --preset demo --cells 64 --steps 12 --rounds 1 --json >"$W/$n.json" 2>"$W/err" || { echo "growth.sh: $(tail -1 "$W/err")"; exit 1; }
    eval "peak$n=$(sed -E 's/.*"peak_bytes": ([0-9]+).*/\1/' "$W/$n.json")"
done
slope=$(((peak60 - peak20) / (40 * 192 * 144)))
echo "growth.sh: figure: $slope bytes a pixel more ($((peak20 / 1000000)) MB with 20 photos, $((peak60 / 1000000)) MB with 60)"
[ $slope -lt 64 ]
