#!/bin/bash
# The main job end to end on the procedural attraction: photos -> scene -> a photo widened, beside the truth. Everything goes to build/demo.
set -eu
build=$1
out=build/demo
start=$SECONDS
mkdir -p $out
echo "== an attraction: 24 photos of a place under as many lights, and 6 test photos"
"$build"/tools/attraction $out/attraction
echo "== learning it"
"$build"/oriel-train fit $out/attraction -o $out/attraction.oriel --preset demo --json
"$build"/oriel info $out/attraction.oriel
echo "== widening a test photo"
"$build"/oriel extend --scene $out/attraction.oriel $out/attraction/photos/test_000.jpg --pose $out/attraction/gt/wide_test_000.txt -o $out/wide.png --report
"$build"/tools/panel $out/attraction/photos/test_000.jpg $out/wide.png $out/attraction/gt/wide_test_000.png $out/attraction/gt/wide_test_000.txt $out/demo.png
echo "$out/demo.png: the photo, the widened photo, the truth ($((SECONDS - start)) s)"
