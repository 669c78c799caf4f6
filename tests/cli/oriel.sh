#!/bin/bash
# The program end to end on a scene, photo and clip made by tests/tools/synth.c. $1: build folder. Tools that are not here (cross compiler, qemu, ffmpeg) are named and their part left out.
set -u
B=${1:-build/host}
O=$B/oriel
. tests/cli/common.bash
has() { "$O" --version | grep '^images:' | grep -q "$1"; }

has png || { echo "oriel.sh: skipped, built without PNG"; exit 77; }
"$B/tools/synth" "$W" 6 3 || exit 1
scene="--scene $W/scene.oriel" pose="--pose $W/pose.txt" clip="--source replay:$W/clip.y4m"

# what it says about itself
"$O" --help | grep -q extend || fail "--help"
"$O" --version | grep -q '^cpu: ' || fail "--version"
for c in info extend relight bake run bench; do "$O" $c --help | grep -q "Usage: oriel $c" || fail "$c --help"; done
"$O" info "$W/scene.oriel" | grep -q 'PSDF' || fail "info"
"$O" info --json "$W/scene.oriel" | grep -q '"title": "synthetic"' || fail "info --json"
if command -v python3 >/dev/null; then "$O" info --json "$W/scene.oriel" | python3 -m json.tool >/dev/null || fail "info --json is not JSON"; fi

# one hash for threads, kernels, machines
want=$("$O" run $scene $pose $clip --sink hash: --cpu=ref --threads=1)
[[ $want = hash\ *6\ frames\ of\ 200\ x\ 120 ]] || fail "run said '$want'"
for cpu in ref auto avx2 avx512 neon dotprod; do
    for threads in 1 2 3 4; do
        got=$("$O" run $scene $pose $clip --sink hash: --cpu=$cpu --threads=$threads 2>"$W/err") || { grep -q 'does not have it' "$W/err" || fail "--cpu=$cpu: $(cat "$W/err")"; continue; }
        [ "$got" = "$want" ] || fail "--cpu=$cpu --threads=$threads: $got, not $want"
    done
done
# a baked view: another picture (its suns are looked up), but one, and close
"$O" bake $scene $pose -o "$W/kiosk.oriel" >"$W/out" || fail "bake"
grep -q '200 x 120 pixels' "$W/out" || fail "bake said $(cat "$W/out")"
baked=$("$O" run --view "$W/kiosk.oriel" $clip --sink hash: --cpu=ref --threads=1) || fail "run --view"
for cpu in auto avx2 avx512; do
    got=$("$O" run --view "$W/kiosk.oriel" $clip --sink hash: --cpu=$cpu --threads=2 2>"$W/err") || { grep -q 'does not have it' "$W/err" || fail "--view --cpu=$cpu: $(cat "$W/err")"; continue; }
    [ "$got" = "$baked" ] || fail "--view --cpu=$cpu: $got, not $baked"
done
"$O" bench --view "$W/kiosk.oriel" $clip --json >"$W/out" || fail "bench --view"
grep -q '"name": "blend ref", "seconds": [0-9.e-]*, "bytes": [0-9]*, "ratio": [0-9.e+]*, "against": "memcpy"}' "$W/out" || fail "bench says no ratio: $(grep blend "$W/out")"
db=$(grep -oE '"sun, shade, tone ref".*"error_db": [0-9]+' "$W/out" | grep -oE '[0-9]+$')
[ "${db:-0}" -ge 50 ] || fail "bench: shading is ${db:-?} dB from the float model"
if command -v python3 >/dev/null; then python3 -c 'import json, sys; [json.loads(l) for l in sys.stdin]' <"$W/out" || fail "bench --json is not JSON"; fi
# every setting and every skip, with its error and what it changes; better settings are nearer to the exact picture
"$O" bench $scene $pose --view "$W/kiosk.oriel" $clip --svg "$W/settings.svg" --json >"$W/out" || fail "bench of scene and view"
grep -q '^{"name": "light: stayed", "pictures": 0, "of": 6}' "$W/out" || fail "bench: $(grep stayed "$W/out")"
db() { grep -oE "\"setting: $1 $2\".*\"error_db\": [0-9]+" "$W/out" | grep -oE '[0-9]+$' || echo 0; }
last=0
for setting in '1 ray, quarter size, traced' '1 ray, half size, traced' '1 ray, horizons' '4 rays, traced'; do
    [ "$(db "$setting" ref)" -gt $last ] || fail "bench: $setting is $(db "$setting" ref) dB from the exact picture, the setting before $last"
    last=$(db "$setting" ref)
done
[ "$last" -ge 38 ] && [ "$(db '4 rays, traced' float)" -ge $last ] || fail "bench: the best setting is $last dB from the exact picture, in float $(db '4 rays, traced' float)"
[ "$(db '4 rays, traced, blended' ref)" -ge $last ] || fail "bench: a photo of the model itself, blended in, takes it away from the exact picture"
[ "$(db '4 rays, baked' ref)" -ge 30 ] || fail "bench: baked suns are $(db '4 rays, baked' ref) dB from the exact picture"
for skip in photo sky shadow same; do grep -qE "\"name\": \"skip: $skip, .*\"without_seconds\": [0-9.e-]+, \"saved\": .*\"identical\": true" "$W/out" || fail "bench: skip $skip: $(grep "skip: $skip" "$W/out")"; done
for skip in empty bake; do grep -qE "\"name\": \"skip: $skip, .*(\"identical\": true|\"change_db\": [3-9][0-9])" "$W/out" || fail "bench: skip $skip: $(grep "skip: $skip" "$W/out")"; done
if command -v python3 >/dev/null; then
    python3 -c 'import json, sys; [json.loads(l) for l in sys.stdin]' <"$W/out" || fail "bench --json of scene and view is not JSON"
    cp "$W/wide.png" "$W/a \"name\".png"
    "$O" bench $scene $pose --reference "$W/a \"name\".png" --json | python3 -c 'import json, sys; sys.exit(not any(json.loads(l).get("error_of", "").endswith("a \"name\".png") for l in sys.stdin))' || fail "bench --json: the reference's name"
    python3 -c 'import sys, xml.dom.minidom as x; c = x.parse(sys.argv[1]).getElementsByTagName("circle"); sys.exit(len(c) < 30)' "$W/settings.svg" || fail "bench --svg: $(head -c 300 "$W/settings.svg")"
fi
[ "$(grep -c '>4 rays, traced, blended</text>' "$W/settings.svg")" = 1 ] && grep -q 'kernels ref, a picture' "$W/settings.svg" || fail "bench --svg: what it names"
"$O" bench $scene $pose --reference "$W/wide.png" --light 0 >"$W/out" || fail "bench --reference"
grep -q '^sun, traced' "$W/out" && grep -q "^setting: 4 rays, traced  *ref .* dB from $W/wide.png" "$W/out" || fail "bench --reference: $(grep setting "$W/out" | tail -1)"
expect 1 'photo.png: 160 x 120 pixels, the wide view has 200 x 120' "$O" bench $scene $pose --reference "$W/photo.png"
expect 1 '--light 1000' "$O" bench $scene $pose --light 1000
expect 1 'baked for another' "$O" bench $scene $pose --view "$W/kiosk.oriel" --size 100x60
expect 1 'nothing/x.svg' "$O" bench $scene $pose --svg "$W/nothing/x.svg"
expect 2 "wanted are --view, or both" "$O" bench $clip
for skip in --no-skip=photo,sky,shadow,same,empty --no-skip=photo --no-skip=sky,shadow --no-skip=same,empty; do
    for cpu in ref auto; do
        [ "$("$O" run --view "$W/kiosk.oriel" $clip --sink hash: $skip --cpu=$cpu)" = "$baked" ] || fail "$skip --cpu=$cpu: another picture"
        [ "$("$O" run $scene $pose $clip --sink hash: $skip --cpu=$cpu)" = "$want" ] || fail "$skip --cpu=$cpu: another picture of the scene"
    done
done
expect 2 'none of photo, sky' "$O" run $scene $pose $clip --sink hash: --no-skip=photo,haste
# a light that stays is shaded once
for every in 2 4; do
    a=$("$O" run $scene $pose $clip --sink hash: --adapt-every $every) b=$("$O" run $scene $pose $clip --sink hash: --adapt-every $every --no-skip=same)
    [ "$a" = "$b" ] && [ "$a" != "$want" ] || fail "--adapt-every $every: $a, and without what was kept $b"
done
"$O" info "$W/kiosk.oriel" | grep -q "a photo of 160 x 120, .* widened to 200 x 120" || fail "info of a baked file"
if command -v python3 >/dev/null; then "$O" info --json "$W/kiosk.oriel" | python3 -m json.tool >/dev/null || fail "info --json of a baked file"; fi
expect 1 "no baked view" "$O" run --view "$W/scene.oriel" $clip --sink hash:
expect 1 "no surface" "$O" run --scene "$W/kiosk.oriel" $pose $clip --sink hash:
expect 2 "either --view or both" "$O" run --view "$W/kiosk.oriel" $pose $clip --sink hash:
expect 2 "settled when a view is baked" "$O" run --view "$W/kiosk.oriel" $clip --sink hash: --widen 2
board_want=$("$O" run $scene $pose $clip --sink hash: --frames 3)       # emulation is slow
baked_want=$("$O" run --view "$W/kiosk.oriel" $clip --sink hash: --frames 3)
while read -r board cc qemu cpu name threads; do
    command -v $cc >/dev/null && command -v $qemu >/dev/null || { echo "oriel.sh: no $cc or $qemu here: $board on $cpu left out"; continue; }
    make -s BOARD=$board CC=$cc SAN= build/$board/oriel >"$W/make" 2>&1 || { fail "make BOARD=$board: $(tail -3 "$W/make")"; continue; }
    got=$($qemu -cpu $cpu build/$board/oriel run $scene $pose $clip --sink hash: --cpu=$name --threads=$threads --frames 3)
    [ "$got" = "$board_want" ] || fail "$board on $cpu, $name: $got, not $board_want"
    got=$($qemu -cpu $cpu build/$board/oriel run --view "$W/kiosk.oriel" $clip --sink hash: --cpu=$name --threads=$threads --frames 3)
    [ "$got" = "$baked_want" ] || fail "$board on $cpu, $name, baked: $got, not $baked_want"
done <<END
rpi4 aarch64-linux-gnu-gcc qemu-aarch64-static cortex-a53 neon 1
rpi4 aarch64-linux-gnu-gcc qemu-aarch64-static cortex-a72 neon 2
rpi5 aarch64-linux-gnu-gcc qemu-aarch64-static cortex-a76 dotprod 3
armhf arm-linux-gnueabihf-gcc qemu-arm-static max ref 4
END

# sources and sinks
"$O" run $scene $pose $clip --sink "y4m:$W/wide.y4m" || fail "y4m sink"
expect 1 "shape of its camera" "$O" run --view "$W/kiosk.oriel" --source "replay:$W/wide.y4m" --sink hash:
"$O" run $scene $pose $clip --sink y4m:- | cmp - "$W/wide.y4m" || fail "y4m to standard output"
"$O" run $scene $pose --source replay:- --sink hash: <"$W/clip.y4m" >"$W/out" || fail "source on standard input"
[ "$(cat "$W/out")" = "$want" ] || fail "standard input: another hash"
"$O" run $scene $pose $clip --sink "files:$W/frames/f%03d.png" --frames 3 || fail "files sink"
[ "$(ls "$W/frames")" = $'f000.png\nf001.png\nf002.png' ] || fail "files sink wrote $(ls "$W/frames")"
"$O" run $scene --pose "$W/pose.txt" --source "replay:$W/frames" --sink hash: --size 64x48 >/dev/null 2>"$W/err" && fail "frames of another shape than the camera's were taken"
if command -v ffmpeg >/dev/null; then
    n=$(ffmpeg -v error -i "$W/wide.y4m" -f framecrc - 2>"$W/err" | grep -vc '^#')
    [ "$n" = 6 ] && [ ! -s "$W/err" ] || fail "ffmpeg read $n frames of 6 of the y4m sink: $(head -3 "$W/err")"
    ffmpeg -v error -i "$W/clip.y4m" -q:v 2 "$W/frames/%03d.jpg" && rm "$W"/frames/*.png
    if has jpeg; then "$O" run $scene $pose --source "replay:$W/frames" --sink hash: >"$W/out" || fail "JPEG folder"; grep -q '6 frames' "$W/out" || fail "JPEG folder: $(cat "$W/out")"; fi
else
    echo "oriel.sh: no ffmpeg here: its check of the y4m sink left out"
fi

# extend: the wide truth comes back
"$O" extend $scene $pose "$W/photo.png" -o "$W/e.png" --report >"$W/out" || fail "extend"
grep -q '^adaptation  ' "$W/out" && grep -q '^sun ' "$W/out" && grep -q '^seconds ' "$W/out" || fail "extend --report"
"$O" extend $scene $pose "$W/photo.png" -o "$W/quick.png" --quick && ! cmp -s "$W/e.png" "$W/quick.png" || fail "extend --quick"
if command -v ffmpeg >/dev/null; then
    db=$(ffmpeg -v info -i "$W/quick.png" -i "$W/e.png" -lavfi psnr -f null - 2>&1 | grep -oE 'average:[0-9]+' | cut -d: -f2)
    [ "${db:-0}" -ge 25 ] || fail "extend --quick: ${db:-?} dB from four rays a pixel"
fi
if command -v ffmpeg >/dev/null; then
    db=$(ffmpeg -v info -i "$W/e.png" -i "$W/wide.png" -lavfi psnr -f null - 2>&1 | grep -oE 'average:[0-9]+|average:inf' | cut -d: -f2)
    [ "$db" = inf ] || [ "${db:-0}" -ge 38 ] || fail "extend: $db dB against the wide truth"
fi
"$O" extend $scene $pose "$W/photo.png" -o "$W/e2.png" --widen 1.4 --size 80x60 --no-blend || fail "extend --widen --size"
if has jpeg; then "$O" extend $scene $pose "$W/photo.png" -o "$W/e.jpg" || fail "extend to JPEG"; fi
"$O" extend $scene $pose "$W/photo.png" -o "$W/e3.png" --mask "$W/photo.png" 2>"$W/err" && fail "a mask over everything: no error"
if has exr; then
    "$O" relight $scene $pose --sky "$W/sky.exr" -o "$W/r.png" || fail "relight to PNG"
    "$O" relight $scene $pose --sky "$W/sky.exr" -o "$W/r.exr" --rotate 40 --sun 10,30 || fail "relight to EXR"
    expect 1 sky.exr "$O" relight $scene $pose --sky "$W/nosky.exr" -o "$W/r.png"
    expect 1 photo.png "$O" relight $scene $pose --sky "$W/photo.png" -o "$W/r.png"
fi

# bad input: exit 1, one line that names the file
head -c 1000 "$W/scene.oriel" >"$W/short.oriel"
expect 1 short.oriel "$O" info "$W/short.oriel"
expect 1 nothing "$O" info "$W/nothing"
expect 1 photo.png "$O" info "$W/photo.png"
expect 1 scene.oriel "$O" extend $scene $pose "$W/scene.oriel" -o "$W/x.png"
expect 1 photo.png "$O" extend $scene --pose "$W/photo.png" "$W/photo.png" -o "$W/x.png"
expect 1 colmap "$O" extend $scene --colmap "$W/colmap" "$W/photo.png" -o "$W/x.png"
expect 1 'x.tiff' "$O" extend $scene $pose "$W/photo.png" -o "$W/x.tiff"
expect 1 frames "$O" run $scene $pose --source "replay:$W/nothing/frames" --sink hash:
expect 1 photo.png "$O" run $scene $pose --source "replay:$W/photo.png" --sink hash:
expect 1 v4l2 "$O" run $scene $pose --source v4l2:/dev/video0 --sink hash:
expect 1 'sink x:' "$O" run $scene $pose $clip --sink x:
[ -e "$W/x.png" ] && fail "a failed run left a picture"
# a clip that is cut short, and one with a broken picture: named, repeated, done
head -c 100000 "$W/clip.y4m" >"$W/cut.y4m"
expect 0 'cut.y4m: picture 3' "$O" run $scene $pose --source "replay:$W/cut.y4m" --sink hash:
grep -q '4 frames' "$W/out" || fail "cut clip: $(cat "$W/out")"
cp "$W/clip.y4m" "$W/torn.y4m"
head=$(head -1 "$W/clip.y4m" | wc -c)
printf 'XXXXXX' | dd of="$W/torn.y4m" bs=1 seek=$((head + 2 * (6 + 160 * 120 * 3 / 2))) conv=notrunc status=none
expect 0 'torn.y4m: picture 2' "$O" run $scene $pose --source "replay:$W/torn.y4m" --sink hash:
grep -q '6 frames' "$W/out" || fail "torn clip: $(cat "$W/out")"
head -1 "$W/clip.y4m" >"$W/empty.y4m"
expect 1 'no picture' "$O" run $scene $pose --source "replay:$W/empty.y4m" --sink hash:
if [ -e /dev/full ]; then
    expect 1 '/dev/full' "$O" run $scene $pose $clip --sink y4m:/dev/full
    "$O" info "$W/scene.oriel" >/dev/full 2>"$W/err" && fail "info to a full disk: exit 0"
fi

# wrong usage: 2
expect 2 "no command" "$O" frobnicate
expect 2 "unknown option --frob" "$O" extend --frob
expect 2 "needs a value" "$O" extend --scene
expect 2 "wanted are" "$O" extend $scene $pose
expect 2 "wanted are" "$O" run $scene $pose
expect 2 "one scene file" "$O" info
expect 2 "--threads" "$O" run $scene $pose $clip --sink hash: --threads x
expect 2 "--widen" "$O" extend $scene $pose --widen nan "$W/photo.png" -o "$W/x.png"
expect 2 "--size" "$O" extend $scene $pose --size 10 "$W/photo.png" -o "$W/x.png"
expect 2 "--cpu" "$O" run $scene $pose $clip --sink hash: --cpu=z80
"$O" >"$W/out" 2>"$W/err"
[ $? = 2 ] && [ ! -s "$W/out" ] || fail "no command: not exit 2"

# the Y4M fuzz target over the clips above
san=
case $B in *-san) san="-fsanitize=address,undefined -fno-sanitize-recover=undefined" ;; esac
${CC:-cc} -std=c11 -D_GNU_SOURCE -O1 -g $san -DFUZZ_MAIN -Iinclude -I. -o "$W/fuzz" tests/fuzz/fuzz_y4m.c "$B/liboriel.a" $(pkg-config --libs libjpeg libpng OpenEXR 2>/dev/null) -lpthread -lm && "$W/fuzz" "$W"/*.y4m "$W/photo.png" || fail "fuzz_y4m"
exit $bad
