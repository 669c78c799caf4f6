#!/bin/bash
# Run time against error of a build folder, ratios measured in one run: `oriel bench` on a small made scene shown at 1920 x 1080, marched and baked, the conversion of camera formats,
# the int8 network beside XNNPACK, kernels and network on the boards (counted and estimated), then the trainer's own. --json: one object a row.
#   tests/bench.sh BUILD [--json]
set -eu
B=$1
W=$(mktemp -d)
trap 'rm -rf "$W"' EXIT
"$B/tools/synth" "$W" 6 3
"$B/oriel" bench --scene "$W/scene.oriel" --pose "$W/pose.txt" --size 1920x1152 --source "replay:$W/clip.y4m" "${@:2}"
"$B/oriel" bake --scene "$W/scene.oriel" --pose "$W/pose.txt" --size 640x384 -o "$W/kiosk.oriel" >&2
"$B/oriel" bench --view "$W/kiosk.oriel" --source "replay:$W/clip.y4m" "${@:2}"
"$B/oriel" bench --convert "${@:2}"
"$B/oriel" bench --mlp "${@:2}"
tests/boards.sh "${@:2}" || [ $? = 77 ]
"$B/oriel-train" bench "${@:2}"
