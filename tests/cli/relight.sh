#!/bin/bash
# `oriel relight` end to end: skies in both formats, tones, layers, a day as a clip, what is refused. $1: build folder. oiiotool and ffmpeg check what they can where they are.
set -u
B=${1:-build/host}
O=$B/oriel
. tests/cli/common.bash

for f in png exr; do "$O" --version | grep '^images:' | grep -q $f || { echo "relight.sh: skipped, built without $f"; exit 77; }; done
"$B/tools/synth" "$W" 1 || exit 1
view="relight --scene $W/scene.oriel --pose $W/pose.txt --size 100x61"
sky="--sky $W/sky.exr"
day="--day 41.9,06-21 --frames 5"

# stills: a tone that does nothing, one that does, and the formats
"$O" $view $sky -o "$W/plain.png" || fail "plain"
printf '# A and b\n1 0 0 0\n0 1 0 0\n0 0 1 0\n' >"$W/one.txt"
printf '0 0 1 0\n0 1 0 0\n1 0 0 0\n' >"$W/swap.txt"
for t in neutral "$W/one.txt" warm cool faded mono contrast "$W/swap.txt"; do
    "$O" $view $sky --tone "$t" -o "$W/toned.png" || fail "--tone $t"
    case $t in
        neutral|"$W/one.txt") cmp -s "$W/plain.png" "$W/toned.png" || fail "--tone $t is not what no tone is" ;;
        *) cmp -s "$W/plain.png" "$W/toned.png" && fail "--tone $t changes nothing" ;;
    esac
done
"$O" $view $sky --exposure -1 -o "$W/dark.png" && ! cmp -s "$W/plain.png" "$W/dark.png" || fail "--exposure"
for t in 1 2 3; do "$O" $view $sky --threads $t -o "$W/t.png" && cmp -s "$W/plain.png" "$W/t.png" || fail "--threads $t: another picture"; done
"$O" $view $sky -o "$W/a.exr" && "$O" $view $sky --tone mono --exposure 3 -o "$W/b.exr" && cmp -s "$W/a.exr" "$W/b.exr" || fail "an EXR took a tone or an exposure"
"$O" $view $sky --sun 200,20 -o "$W/moved.exr" || fail "--sun"

if command -v oiiotool >/dev/null; then
    # largest OPTION...: the largest value of any channel
    largest() { oiiotool "$@" --printstats 2>&1 | awk '/Stats Max/ { for (i = 3; i <= NF; i++) if ($i + 0 > m) m = $i + 0 } END { print m + 0 }'; }
    below() { awk "BEGIN { exit !($1 < $2) }"; }
    oiiotool "$W/plain.png" --ch B,G,R "$W/toned.png" --fail 0 --diff >/dev/null || fail "--tone swap.txt did not swap red and blue"
    oiiotool "$W/sky.exr" -o "$W/sky.hdr" && "$O" $view --sky "$W/sky.hdr" -o "$W/hdr.png" || fail "--sky sky.hdr"
    oiiotool "$W/plain.png" "$W/hdr.png" --fail 0.02 --diff >/dev/null || fail "sky.hdr is not sky.exr: $(oiiotool "$W/plain.png" "$W/hdr.png" --diff | grep Max)"
    list=$(oiiotool --info -v "$W/a.exr" | sed -n 's/ *channel list: //p' | tr -d ' ' | tr , '\n' | sort | tr '\n' ' ')
    want="A B G R Z albedo.B albedo.G albedo.R irradiance.B irradiance.G irradiance.R normal.X normal.Y normal.Z shadow.Y sky.B sky.G sky.R "
    [ "$list" = "$(echo $want | tr ' ' '\n' | sort | tr '\n' ' ')" ] || fail "layers: $list"
    rgb() { echo "--ch R=$1.R,G=$1.G,B=$1.B"; }
    model="$W/a.exr $(rgb albedo) $W/a.exr $(rgb irradiance) --mul --mulc 0.318309886 $W/a.exr --ch R=A,G=A,B=A --mul $W/a.exr $(rgb sky) --add"
    top=$(largest "$W/a.exr" --ch R,G,B)
    off=$(largest $model "$W/a.exr" --ch R,G,B --absdiff)
    below 0.01 "$top" && below "$off" 0.00001 || fail "R is not A albedo irradiance / pi + sky: off by $off, largest $top"
    off=$(largest "$W/a.exr" --ch shadow.Y "$W/moved.exr" --ch shadow.Y --absdiff)
    below 0.2 "$off" || fail "the sun moved, its shadows did not: $off"
    for layer in albedo.R,albedo.G,albedo.B normal.X,normal.Y,normal.Z Z A; do
        oiiotool "$W/a.exr" --ch $layer "$W/moved.exr" --ch $layer --fail 0 --diff >/dev/null || fail "the sun moved, and $layer with it"
    done
else
    echo "relight.sh: no oiiotool here: layers, swapped colours and the .hdr sky left out"
fi

# a day
"$O" $view $sky $day -o "$W/day.y4m" 2>"$W/err" || fail "--day: $(cat "$W/err")"
grep -q '^frame 5 of 5' "$W/err" || fail "--day shows no progress: $(cat "$W/err")"
head -1 "$W/day.y4m" | grep -q '^YUV4MPEG2 W100 H61 F25:1 ' || fail "clip: $(head -1 "$W/day.y4m" | head -c 100)"
size=$(($(head -1 "$W/day.y4m" | wc -c) + 5 * (6 + 100 * 61 + 2 * 50 * 31)))
[ "$(wc -c <"$W/day.y4m")" = $size ] || fail "clip of $(wc -c <"$W/day.y4m") bytes, not $size"
for t in 1 2 3; do "$O" $view $sky $day --threads $t -o - 2>/dev/null | cmp - "$W/day.y4m" || fail "--day --threads $t: another clip"; done
"$O" $view $sky $day --tone mono -o "$W/mono.y4m" 2>/dev/null && ! cmp -s "$W/mono.y4m" "$W/day.y4m" || fail "--day --tone"
"$O" $view $sky $day --north 0 -o "$W/north.y4m" 2>/dev/null && ! cmp -s "$W/north.y4m" "$W/day.y4m" || fail "--day --north"
if command -v ffmpeg >/dev/null; then
    n=$(ffmpeg -v error -i "$W/day.y4m" -f framemd5 - 2>"$W/err" | grep -v '^#' | awk '{ print $NF }' | sort -u | wc -l)
    [ "$n" = 5 ] && [ ! -s "$W/err" ] || fail "ffmpeg read $n different frames of 5: $(head -3 "$W/err")"
else
    echo "relight.sh: no ffmpeg here: its check of the clip left out"
fi

# bad input: 1, and the file or the day by name
printf '#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99 +X 99\n' >"$W/short.hdr"
printf '#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 8 +X 8\n' >"$W/xyze.hdr"
printf '#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 8\n' >"$W/even.hdr"
for i in $(seq 64); do printf 'dddd' >>"$W/even.hdr"; done
printf '1 2 3' >"$W/three.txt"
expect 1 'short.hdr: size 99 x 99' "$O" $view --sky "$W/short.hdr" -o "$W/x.png"
expect 1 'xyze.hdr: FORMAT' "$O" $view --sky "$W/xyze.hdr" -o "$W/x.png"
expect 1 'even.hdr: no sun in it that --sun' "$O" $view --sky "$W/even.hdr" --sun 0,30 -o "$W/x.png"
expect 1 'even.hdr: no sun in it that --day' "$O" $view --sky "$W/even.hdr" $day -o "$W/x.y4m"
expect 1 'nothing.hdr' "$O" $view --sky "$W/nothing.hdr" -o "$W/x.png"
expect 1 'plain.png: neither' "$O" $view --sky "$W/plain.png" -o "$W/x.png"
expect 1 'three.txt: 3 numbers' "$O" $view $sky --tone "$W/three.txt" -o "$W/x.png"
expect 1 'sepia: no such file, and no preset (neutral' "$O" $view $sky --tone sepia -o "$W/x.png"
expect 1 'x.tiff' "$O" $view $sky -o "$W/x.tiff"
expect 1 'none/x.y4m' "$O" $view $sky $day -o "$W/none/x.y4m"
expect 1 'none/x.exr' "$O" $view $sky -o "$W/none/x.exr"
expect 1 '--day 80,355: the sun does not rise' "$O" $view $sky --day 80,12-21 -o "$W/x.y4m"
if [ -e /dev/full ]; then
    "$O" $view $sky $day -o - >/dev/full 2>"$W/err"
    [ $? = 1 ] && grep -q 'standard output' "$W/err" || fail "clip to a full disk: $(cat "$W/err")"
fi

# wrong usage: 2
expect 2 'wanted are' "$O" $view -o "$W/x.png"
expect 2 '--sun 10' "$O" $view $sky --sun 10 -o "$W/x.png"
expect 2 '--sun 10,95' "$O" $view $sky --sun 10,95 -o "$W/x.png"
for d in 91 x 40x 40, 40,0 40,367 40,13-01 40,02-30 40,1-1-1 nan; do expect 2 "--day $d: " "$O" $view $sky --day $d -o "$W/x.y4m"; done
expect 2 '--day makes a .y4m' "$O" $view $sky --day 40 -o "$W/x.png"
expect 2 'made with --day' "$O" $view $sky -o "$W/x.y4m"
expect 2 'both move' "$O" $view $sky $day --sun 1,2 -o "$W/x.y4m"
expect 2 'go with --day' "$O" $view $sky --frames 3 -o "$W/x.png"
expect 2 '--frames 0' "$O" $view $sky --day 40 --frames 0 -o "$W/x.y4m"
expect 2 'more: not an option' "$O" $view $sky -o "$W/x.png" more
ls "$W" | grep -E '^x\.|\.tmp' && fail "a failed run left these"
exit $bad
