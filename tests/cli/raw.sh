#!/bin/bash
# Raw pictures as a camera stores them: the hash of the Y4M clip that holds the same bytes, on any kernels; what is cut or misdescribed is named in a line. `oriel bench --convert`. $1: build folder.
set -u
B=${1:-build/host}
O=$B/oriel
. tests/cli/common.bash
"$B/tools/synth" "$W" 6 3 2>"$W/err" || { echo "raw.sh: skipped: $(cat "$W/err")"; exit 77; }
on="--scene $W/scene.oriel --pose $W/pose.txt --sink hash:"
want=$("$O" run $on --source "replay:$W/clip.y4m") || fail "the Y4M clip"

# 160 x 120, 4:2:0: headers off
frame=$((160 * 120 * 3 / 2)) head=$(head -1 "$W/clip.y4m" | wc -c)
for i in 0 1 2 3 4 5; do tail -c +$((head + i * (6 + frame) + 7)) "$W/clip.y4m" | head -c $frame; done >"$W/clip.raw"
for cpu in auto ref avx2 neon; do
    got=$("$O" run $on --source "raw:i420:160x120@30:$W/clip.raw" --cpu $cpu 2>"$W/err") || { grep -q 'does not have it' "$W/err" || fail "--cpu $cpu: $(cat "$W/err")"; continue; }
    [ "$got" = "$want" ] || fail "--cpu $cpu: $got, not $want"
done
[ "$("$O" run $on --source raw:i420:160x120:- <"$W/clip.raw")" = "$want" ] || fail "standard input"
if command -v ffmpeg >/dev/null; then
    ffmpeg -nostdin -v error -f rawvideo -pix_fmt yuv420p -s 160x120 -i "$W/clip.raw" -f rawvideo -pix_fmt nv12 "$W/clip.nv12"
    [ "$("$O" run $on --source "raw:nv12:160x120:$W/clip.nv12")" = "$want" ] || fail "NV12 of the same pictures"
else
    echo "raw.sh: no ffmpeg here: NV12 left out"
fi

head -c $((3 * frame + 1000)) "$W/clip.raw" >"$W/cut.raw"
expect 0 "cut.raw: picture 3" "$O" run $on --source "raw:i420:160x120:$W/cut.raw"
grep -q '4 frames' "$W/out" || fail "cut file: $(cat "$W/out")"
: >"$W/empty.raw"
expect 1 'no picture' "$O" run $on --source "raw:i420:160x120:$W/empty.raw"
for spec in i420:0x120 i420:160x0 i420:-160x120 i420:160 i420:160x120x3 i420:160x120@0 i420:99999x99999 h264:160x120 i420,2020:160x120; do
    expect 1 'raw:' "$O" run $on --source "raw:$spec:$W/clip.raw"
done
expect 1 'raw:' "$O" run $on --source raw:i420:160x120
expect 1 'raw:' "$O" run $on --source raw:
expect 1 'nothing' "$O" run $on --source "raw:i420:160x120:$W/nothing"
expect 1 'shape of its camera' "$O" run $on --source "raw:i420:120x160:$W/clip.raw"

"$O" bench --convert >"$W/out" || fail "bench --convert"
for name in i420 nv12 yuyv bgr24; do grep -q "convert $name, 1920 x 1080 .*ref.* x memcpy of" "$W/out" || fail "bench --convert: no $name"; done
if command -v python3 >/dev/null; then
    "$O" bench --convert --json | while read -r row; do echo "$row" | python3 -m json.tool >/dev/null || exit 1; done || fail "bench --convert --json is not JSON"
fi
expect 2 convert "$O" bench --convert --scene "$W/scene.oriel"
exit $bad
