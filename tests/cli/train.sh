#!/bin/bash
# oriel-train end to end on a small attraction made by tests/tools/attraction.c: fit, its repeatability, kills, bad checkpoints and photos, layouts, eval, sky, masks.
# $1: build folder (an ASan build takes a smaller run). Tools that are not here (python3, oiiotool, a mountable tmpfs) are named and their part left out.
set -u
B=${1:-build/host}
T=$B/oriel-train
seed=${SEED:-$RANDOM}
RANDOM=$seed
. tests/cli/common.bash
trap 'umount "$W/disk" 2>/dev/null; rm -rf "$W"' EXIT
fail() { echo "train.sh: $* (SEED=$seed)"; bad=1; }

# standard error without fit's progress
quiet() { grep -vE '^\[[#.]{20}\] |^[^:]*: [0-9]+ photos, [0-9]+ points, box |^(stereo|surface|base colour): |: [0-9.]+ MB, [0-9]+ bricks, ' "$1"; }

# json FILE KEY...: valid JSON with these keys; a.b is b within a
json() {
    local file=$1 key
    shift
    if command -v python3 >/dev/null; then
        python3 - "$file" "$@" <<'END' || fail "${file##*/}: $(head -c 300 "$file")"
import json, math, sys
whole = json.load(open(sys.argv[1]))
for key in sys.argv[2:]:
    part = whole
    for name in key.split('.'):
        part = part[int(name) if isinstance(part, list) else name]
    if isinstance(part, float) and not math.isfinite(part):
        sys.exit(key + ' is not finite')
END
    else
        for key in "$@"; do grep -q "\"${key##*.}\": " "$file" || fail "no $key in ${file##*/}"; done
    fi
}

for format in jpeg png exr; do
    "$B/oriel" --version | grep '^images:' | grep -q $format || { echo "train.sh: skipped, built without ${format^^}"; exit 77; }
done
photos=6 width=128 steps=200 rounds=12
case $B in *-san) photos=6 width=96 steps=60 rounds=6 ;; esac
# place, other: two photo collections of one place, the first with sky masks
mkdir "$W/other" "$W/imc" "$W/disk"
place=$W/place other=$W/other/place
"$B/tools/attraction" --photos=$photos --tests=2 --width=$width --frames=0 --points=1200 --masks "$place" >"$W/out" || exit 1
mv "$place/gt/masks" "$place/masks"
"$B/tools/attraction" --photos=$photos --tests=0 --width=$width --frames=0 --points=1200 --seed=2 "$other" >"$W/out" || exit 1
size="--preset demo --cells 64 --threads 2 --steps $steps --rounds $rounds"
# fit FILE [OPTION]...: place, into $W/FILE.oriel
fit() { local file=$1; shift; "$T" fit "$place" -o "$W/$file.oriel" $size "$@"; }
same() { cmp -s "$W/$1.oriel" "$W/$2.oriel"; }

# fit: figures, a scene that oriel reads, a checkpoint; once more the same bytes; another seed, others
fit ref --json >"$W/fit.json" 2>"$W/err" || fail "fit: $(tail -3 "$W/err")"
json "$W/fit.json" seconds cpu_seconds samples_per_core_second peak_bytes scene_bytes dropped_steps
[ -s "$W/ref.oriel.ckpt" ] || fail "no checkpoint"
"$B/oriel" info "$W/ref.oriel" >"$W/info" || fail "info"
grep -q "ref.oriel: place, $(stat -c %s "$W/ref.oriel") bytes" "$W/info" && grep -q "codes  *$photos training photos" "$W/info" || fail "info: $(cat "$W/info")"
grep -q "\"scene_bytes\": $(stat -c %s "$W/ref.oriel")[,}]" "$W/fit.json" || fail "scene_bytes: $(cat "$W/fit.json")"
fit again >/dev/null 2>"$W/err" || fail "fit again: $(tail -3 "$W/err")"
same ref again || fail "the same fit twice: other bytes"
fit seed --seed 2 >/dev/null 2>"$W/err" || fail "fit --seed 2: $(tail -3 "$W/err")"
same ref seed && fail "--seed 2 changes nothing"

# killed PHASE N: the run from the last phase's checkpoint on, killed once N checkpoints of this phase (0 stereo, 1 and 2 the stages) were seen; there is a checkpoint after every step,
# so that the kill often meets a half written one. A kill that comes too late is tried again.
phase() { od -An -tu4 -j8 -N4 "$1" 2>/dev/null | tr -d ' '; }
killed() {
    local want=$1 ckpt=$W/killed.oriel.ckpt left seen now pid try resume=
    for try in 1 2 3 4 5; do
        rm -f "$ckpt" "$W/killed.oriel"
        [ "$want" = 0 ] || { resume=--resume; cp "$W/phase$((want - 1))" "$ckpt"; }
        left=$2 seen=$(stat -c %y "$ckpt" 2>/dev/null)
        "$T" fit "$place" -o "$W/killed.oriel" $size --checkpoint-seconds 0 $resume >/dev/null 2>"$W/err" &
        pid=$!
        while [ "$left" -gt 0 ] && kill -0 $pid 2>/dev/null; do
            now=$(stat -c %y "$ckpt" 2>/dev/null)
            if [ "$now" != "$seen" ] && [ "$(phase "$ckpt")" = "$want" ]; then seen=$now left=$((left - 1)); fi
            sleep 0.00$((RANDOM % 10))
        done
        sleep 0.0$((RANDOM % 10))
        kill -9 $pid 2>/dev/null
        wait $pid 2>/dev/null
        [ "$left" = 0 ] && [ "$(phase "$ckpt")" = "$want" ] && { cp "$ckpt" "$W/phase$want"; return; }
    done
    fail "phase $want was not met by a kill: the checkpoint is of phase $(phase "$ckpt"), $(tail -2 "$W/err")"
    exit 1
}
killed 0 $((1 + RANDOM % 3))
killed 1 $((1 + RANDOM % (steps / 6)))
killed 2 $((1 + RANDOM % (rounds / 2)))
fit killed --resume >/dev/null 2>"$W/err" || fail "fit --resume: $(tail -3 "$W/err")"
same ref killed || fail "killed in stereo, stage 1 and stage 2, then resumed: other bytes than the unbroken run"
[ "$(cd "$W" && ls killed*)" = $'killed.oriel\nkilled.oriel.ckpt' ] || fail "a kill left behind: $(ls "$W" | grep killed)"
# a finished run, resumed, writes its scene again; its geometry alone gives it as well
rm "$W/killed.oriel"
fit killed --resume --json >"$W/fit.json" 2>"$W/err" || fail "--resume of a finished run: $(tail -3 "$W/err")"
json "$W/fit.json" seconds scene_bytes
same ref killed || fail "--resume of a finished run: other bytes"
fit again --stage2 >/dev/null 2>"$W/err" || fail "fit --stage2: $(tail -3 "$W/err")"
same ref again || fail "--stage2: other bytes than the run whose geometry it takes"
fit again --stage2 --light paper --without tone,sky-prior >/dev/null 2>"$W/err" || fail "fit --light paper: $(tail -3 "$W/err")"
same ref again && fail "--light paper --without tone changes nothing"
fit again --stage2 >/dev/null 2>"$W/err" && same ref again || fail "--stage2 after --light paper: other bytes than the first run: $(tail -3 "$W/err")"
expect 2 '--without: tone,sun is out of range' "$T" fit "$place" -o "$W/bad.oriel" $size --without tone,sun
expect 2 '--light: papers is out of range' "$T" fit "$place" -o "$W/bad.oriel" $size --light papers

# bad checkpoints: one line that names the file, no scene
resume() { # PATTERN SCENE [OPTION]...
    expect 1 "$1" "$T" fit "$2" -o "$W/bad.oriel" $size --resume "${@:3}"
    [ -e "$W/bad.oriel" ] && { fail "a scene from a bad checkpoint ($1)"; rm "$W/bad.oriel"; }
}
ckpt=$W/bad.oriel.ckpt
resume 'bad.oriel.ckpt' "$place"
head -c 87 "$W/phase2" >"$ckpt"
resume 'bad.oriel.ckpt: not a checkpoint' "$place"
cp "$place/photos/train_000.jpg" "$ckpt"
resume 'bad.oriel.ckpt: not a checkpoint' "$place"
for p in 0 1 2; do
    whole=$(stat -c %s "$W/phase$p")
    for bytes in 88 $((whole / 3)) $((whole - 1)); do
        head -c "$bytes" "$W/phase$p" >"$ckpt"
        resume 'bad.oriel.ckpt: ' "$place"
    done
    { head -c 88 "$W/phase$p"; cat "$place"/photos/*.jpg; } >"$ckpt"
    resume 'bad.oriel.ckpt: ' "$place"
done
spoil() { cp "$W/phase1" "$ckpt"; printf "$2" | dd of="$ckpt" bs=1 seek="$1" conv=notrunc status=none; }
for at in 8 20 36 40; do                        # header: phase, rays, threads, photos
    spoil $at '\377\377\377\377'
    resume 'bad.oriel.ckpt: not a checkpoint' "$place"
done
whole=$(stat -c %s "$W/phase1")
for at in 48 84 $((whole / 2)) $((whole - 2)); do       # seed, checksum, somewhere, the end
    spoil $at '\125\252'
    resume 'bad.oriel.ckpt: damaged' "$place"
done
expect 1 'bad.oriel.ckpt: damaged' "$T" eval "$place" --scene "$W/ref.oriel" --checkpoint "$ckpt"
cp "$W/phase2" "$ckpt"
resume 'bad.oriel.ckpt: made from other photos' "$other"
cp -r "$place" "$W/swapped"                     # the same box and cameras, but two photos have changed places
sed -i 's/train_000\.jpg/x/; s/train_002\.jpg/train_000.jpg/; s/ x$/ train_002.jpg/' "$W/swapped/sparse/0/images.txt"
cp "$W/phase1" "$ckpt"
resume 'bad.oriel.ckpt: made from other photos' "$W/swapped"
cp "$W/phase1" "$ckpt"
expect 1 'bad.oriel.ckpt: stage 1 has not finished' "$T" fit "$place" -o "$W/bad.oriel" $size --stage2
cp "$W/ref.oriel.ckpt" "$ckpt"
truncate -s -1 "$ckpt"
resume 'bad.oriel.ckpt: ' "$place"
expect 1 'phase1: training has not finished' "$T" eval "$place" --scene "$W/ref.oriel" --checkpoint "$W/phase1"

# a full disk: one line that names the file, what was there stays, nothing is left over
full() { # FOLDER REASON COMMAND...
    local dir=$1 reason=$2
    expect 1 "d.oriel[.ckpt]*: $reason" "${@:3}"
    cmp -s "$W/phase1" "$dir/d.oriel.ckpt" || fail "$reason: the earlier checkpoint has changed"
    [ "$(ls "$dir")" = d.oriel.ckpt ] || fail "$reason: left behind: $(ls "$dir")"
}
limited() { (ulimit -f "$1"; "${@:2}"); }
bytes=$(stat -c %s "$W/phase1")
if [ "$(id -u)" = 0 ] && mount -t tmpfs -o size=$((bytes * 3 / 2)) tmpfs "$W/disk" 2>/dev/null; then
    cp "$W/phase1" "$W/disk/d.oriel.ckpt"
    full "$W/disk" 'No space left' "$T" fit "$place" -o "$W/disk/d.oriel" --resume --checkpoint-seconds 0
    umount "$W/disk"
else
    echo "train.sh: no tmpfs can be mounted here: the full disk is a file size limit only"
fi
mkdir "$W/limit"
cp "$W/phase1" "$W/limit/d.oriel.ckpt"
full "$W/limit" 'File too large' limited $((bytes / 1024 / 2)) "$T" fit "$place" -o "$W/limit/d.oriel" --resume --checkpoint-seconds 0
cp "$W/ref.oriel" "$W/limit/d.oriel"
cp "$W/ref.oriel.ckpt" "$W/limit/d.oriel.ckpt"
expect 1 'd.oriel: File too large' limited 100 "$T" fit "$place" -o "$W/limit/d.oriel" --resume
cmp -s "$W/ref.oriel" "$W/limit/d.oriel" && cmp -s "$W/ref.oriel.ckpt" "$W/limit/d.oriel.ckpt" || fail "the earlier scene or checkpoint has changed"
[ "$(ls "$W/limit")" = $'d.oriel\nd.oriel.ckpt' ] || fail "left behind: $(ls "$W/limit")"
expect 1 'nowhere/x.oriel' "$T" fit "$place" -o "$W/nowhere/x.oriel" --resume
expect 1 'nowhere/x.oriel: No such' "$T" fit "$place" -o "$W/nowhere/x.oriel"
if [ -e /dev/full ]; then
    "$T" masks "$place" --json >/dev/full 2>"$W/err" && fail "masks to a full disk: exit 0"
    "$T" fit --help >/dev/full 2>"$W/err" && fail "--help to a full disk: exit 0"
fi

# photos and folders that are broken
short="--preset demo --cells 64 --threads 2 --steps 5 --rounds 1"
broken=$W/'a "broken" place'                      # a name that JSON must escape
cp -r "$place" "$broken"
echo 'no photo' >"$broken/photos/train_003.jpg"
echo 'no photo' >"$broken/photos/test_000.jpg"
expect 0 'train_003.jpg' "$T" fit "$broken" -o "$W/x.oriel" $short --no-masks --json
json "$W/out" scene bricks
"$B/oriel" info "$W/x.oriel" | grep -q "codes  *$((photos - 1)) training photos" || fail "a broken photo: $("$B/oriel" info "$W/x.oriel" | tail -1)"
expect 0 'test_000.jpg' "$T" eval "$broken" --scene "$W/ref.oriel" --json
json "$W/out" mean.fixed.psnr
"$T" masks "$broken" >"$W/out" 2>"$W/err"
[ $? = 1 ] && [ "$(grep -c 'place/photos/.*does not decode' "$W/err")" = 2 ] && grep -q train_004.jpg "$W/out" || fail "masks with broken photos: $(cat "$W/err")"
rm "$W/x.oriel" "$W/x.oriel.ckpt"
for f in "$broken"/photos/*; do echo 'no photo' >"$f"; done
"$T" fit "$broken" -o "$W/x.oriel" $short >"$W/out" 2>"$W/err"
[ $? = 1 ] && [ "$(wc -l <"$W/err")" = $((photos + 1)) ] && tail -1 "$W/err" | grep -q 'place: .*photos' || fail "all photos broken: $(cat "$W/err")"
rm -r "$broken/sparse"
expect 1 'place: no COLMAP model' "$T" fit "$broken" -o "$W/x.oriel" $short
mkdir -p "$broken/sparse/0"
cp "$place/photos/train_000.jpg" "$broken/sparse/0/cameras.txt"
expect 1 'place/sparse/0' "$T" fit "$broken" -o "$W/x.oriel" $short
rm -r "$broken/photos"
expect 1 'place: no photos' "$T" fit "$broken" -o "$W/x.oriel" $short
expect 1 'nothing: no such folder' "$T" fit "$W/nothing" -o "$W/x.oriel" $short
expect 1 'nothing: no such folder' "$T" eval "$W/nothing" --baselines-only
expect 1 'nothing: no such folder' "$T" masks "$W/nothing"
expect 1 'photo.jpg' "$T" fit "$place" -o "$W/x.oriel" $short --sky "$W/photo.jpg"
ls "$W"/x.oriel* >/dev/null 2>&1 && fail "a failed fit left $(ls "$W"/x.oriel*)"

# IMC-PT's layout: one model with the test photos in it (here with sightings, which must not count), NeRF-W's table; the test photos cannot train, for they are not photos yet
imc=$W/imc/place
mkdir -p "$imc/dense/sparse"
cp -r "$place/photos" "$imc/dense/images"
cp -r "$place/masks" "$imc"
for f in "$imc"/dense/images/test_*; do echo 'no photo' >"$f"; done
cp "$place/sparse/0/points3D.txt" "$imc/dense/sparse"
{ cat "$place/sparse/0/cameras.txt"; awk '!/^#/ { $1 += 1000; print }' "$place/sparse_test/0/cameras.txt"; } >"$imc/dense/sparse/cameras.txt"
{ cat "$place/sparse/0/images.txt"
  awk '/^#/ { next } NF > 8 { $1 += 1000; $9 += 1000; print; print "10 20 1 30 40 2 50 60 3 70 80 4" }' "$place/sparse_test/0/images.txt"; } >"$imc/dense/sparse/images.txt"
cp "$place/split.tsv" "$imc/attraction.tsv"
"$T" fit "$imc" -o "$W/imc.oriel" $size >/dev/null 2>"$W/err" || fail "IMC-PT's layout: $(tail -3 "$W/err")"
same ref imc || fail "IMC-PT's layout: another scene"

# the NeRF-W baseline: repeats, both encodings, snapshots by the clock, evaluated alone; nothing is left of a fit that fails
nerf() { local file=$1; shift; "$T" fit "$place" --method nerfw -o "$W/$file" $size --steps 12 "$@"; }
nerf a.nerfw --json >"$W/nerfw.json" 2>"$W/err" || fail "fit --method nerfw: $(tail -3 "$W/err")"
json "$W/nerfw.json" seconds cpu_seconds samples_per_core_second peak_bytes
nerf b.nerfw 2>"$W/err" && cmp -s "$W/a.nerfw" "$W/b.nerfw" || fail "the same baseline twice: other bytes"
nerf t.nerfw --encoding textbook --snapshots 0.0005,1000 2>"$W/err" || fail "fit --encoding textbook: $(tail -3 "$W/err")"
[ -s "$W/t.nerfw.0.0005m" ] && ! [ -e "$W/t.nerfw.1000m" ] || fail "snapshots: $(ls "$W"/t.nerfw*)"
"$T" eval "$place" --nerfw "$W/t.nerfw" --limit 1 --json >"$W/nerfw.json" 2>"$W/err" || fail "eval --nerfw alone: $(cat "$W/err")"
json "$W/nerfw.json" mean.nerfw.psnr mean.median_warp.psnr
expect 1 'ref.oriel: not a NeRF-W model' "$T" eval "$place" --nerfw "$W/ref.oriel"
expect 2 '--snapshots' "$T" fit "$place" -o "$W/x.oriel" --snapshots 1
expect 2 'out of range' "$T" fit "$place" -o "$W/x.oriel" --method nerfw --snapshots 2,1
expect 2 'neither resumes' "$T" fit "$place" -o "$W/x.oriel" --method nerfw --resume

# eval: all columns; the same figures from either layout
"$T" eval "$place" --scene "$W/ref.oriel" --nerfw "$W/a.nerfw" --json --out "$W/sheets" >"$W/eval.json" 2>"$W/err" || fail "eval: $(cat "$W/err")"
keys=(protocol photos.0.name photos.1.name)
for column in fixed float nerfw row_mean nearest_warp median_warp; do
    for figure in psnr ssim flip; do keys+=("mean.$column.$figure" "mean_full.$column.$figure" "photos.0.$column.$figure"); done
done
json "$W/eval.json" "${keys[@]}"
cp "$place"/photos/test_* "$imc/dense/images"
"$T" eval "$imc" --scene "$W/imc.oriel" --nerfw "$W/a.nerfw" --json >"$W/imc.json" 2>"$W/err" || fail "eval of IMC-PT's layout: $(cat "$W/err")"
cmp -s "$W/eval.json" "$W/imc.json" || fail "eval of IMC-PT's layout: $(cat "$W/imc.json")"
"$T" eval "$place" --scene "$W/ref.oriel" --geometry --json >"$W/geometry.json" 2>"$W/err" || fail "eval --geometry: $(cat "$W/err")"
json "$W/geometry.json" depth_median_rel normal_mean_deg depth_median_rel_all normal_mean_deg_all scene_missed sky_covered sfm_heldout_median_rel sfm_heldout_points transient_iou
depth=$(grep -oE '"depth_median_rel": [0-9.]+' "$W/geometry.json")      # the model's unit is 0.37 of the truth's metre
awk "BEGIN { exit !(${depth##* } < 0.2) }" || fail "depth against the truth: $depth"
# without ground truth or masks: what is left; a checkpoint of another place is refused
cp -r "$place" "$W/bare"
rm -r "$W/bare/gt" "$W/bare/masks"
"$T" eval "$W/bare" --scene "$W/ref.oriel" --geometry --json >"$W/bare.json" 2>"$W/err" || fail "eval --geometry without gt: $(cat "$W/err")"
json "$W/bare.json" sky_covered sfm_heldout_median_rel sfm_heldout_points
grep -qE 'depth|transient' "$W/bare.json" && fail "figures from nowhere: $(cat "$W/bare.json")"
[ "$(grep -o '"sfm_heldout.*' "$W/bare.json")" = "$(grep -o '"sfm_heldout[^}]*heldout_points": [0-9]*' "$W/geometry.json")}" ] || fail "held-out points: $(cat "$W/bare.json" "$W/geometry.json")"
expect 1 'phase1: training has not finished' "$T" eval "$place" --scene "$W/ref.oriel" --checkpoint "$W/phase1" --geometry

# mesh, plot
"$T" mesh "$W/ref.oriel" -o "$W/mesh.ply" >"$W/out" 2>"$W/err" || fail "mesh: $(cat "$W/err")"
head -c 400 "$W/mesh.ply" | grep -aq "^element vertex $(grep -oE '[0-9]+ vertices' "$W/out" | cut -d' ' -f1)$" || fail "mesh: $(cat "$W/out")"
expect 1 'photo.jpg' "$T" mesh "$W/photo.jpg" -o "$W/no.ply"
expect 1 'nowhere/m.ply' "$T" mesh "$W/ref.oriel" -o "$W/nowhere/m.ply"
expect 2 'none, base or normal' "$T" mesh "$W/ref.oriel" -o "$W/no.ply" --colour red
printf 'series\tminutes\tdB\na <b>\t1\t10\nc\t2\t11\na <b>\t4\t12\n' >"$W/t.tsv"
"$T" plot "$W/t.tsv" -o "$W/t.svg" --log-x --title T 2>"$W/err" || fail "plot: $(cat "$W/err")"
[ "$(grep -c '<circle' "$W/t.svg")" = 3 ] && grep -q 'a &lt;b&gt;' "$W/t.svg" && grep -q minutes "$W/t.svg" || fail "plot: $(cat "$W/t.svg")"
printf 'a\t1\n' >"$W/bad.tsv"
expect 1 'bad.tsv: line 1: three columns' "$T" plot "$W/bad.tsv" -o "$W/no.svg"
printf 'a\t1\t2\na\tx\t2\n' >"$W/bad.tsv"
expect 1 'bad.tsv: line 2: x or y' "$T" plot "$W/bad.tsv" -o "$W/no.svg"
: >"$W/bad.tsv"
expect 1 'bad.tsv: no point' "$T" plot "$W/bad.tsv" -o "$W/no.svg"
# bench: the exact picture; the runtime's finest setting is nearer to it than its coarsest, and nearer still where the model's surface is taken as hard
if read -r _ lens < <(grep '^1 ' "$place/sparse_test/0/cameras.txt") && read -r _ q0 q1 q2 q3 x y z _ < <(grep '^1 ' "$place/sparse_test/0/images.txt"); then
    for name in photo wide; do echo "$name $lens $q0 $q1 $q2 $q3 $x $y $z"; done >"$W/pose.txt"
    place_of="--scene $W/ref.oriel --pose $W/pose.txt --size 96x72"
    db() { "$B/oriel" bench $place_of --reference "$1" --json 2>"$W/err" | grep -oE "\"setting: $2\".*\"error_db\": [0-9.]+" | grep -oE '[0-9.]+$' || { echo 0; cat "$W/err" >&2; }; }
    "$T" bench $place_of --rays 2 --out "$W/soft.png" --json >"$W/exact.json" 2>"$W/err" || fail "bench --scene: $(cat "$W/err")"
    json "$W/exact.json" name seconds rays sigma light width height
    "$T" bench $place_of --rays 2 --out "$W/hard.exr" --sigma 0.05 --threads 2 >"$W/out" 2>"$W/err" || fail "bench --scene --sigma: $(cat "$W/err")"
    soft=$(db "$W/soft.png" '4 rays, traced float') hard=$(db "$W/hard.exr" '4 rays, traced float') coarse=$(db "$W/hard.exr" '1 ray, quarter size, traced float')
    awk "BEGIN { exit !($soft > 20 && $hard > $soft && $hard > $coarse + 3) }" || fail "bench --reference: the exact picture is $soft dB away, with a hard surface $hard, at its coarsest $coarse"
    expect 2 'go together' "$T" bench --scene "$W/ref.oriel"
    expect 2 '17 is out of range' "$T" bench $place_of --out "$W/no.png" --rays 17
    expect 1 'no.ckpt' "$T" bench $place_of --checkpoint "$W/no.ckpt" --out "$W/no.png"
else
    fail "no test camera to bench"
fi

# ablation: a program that stands in for oriel-train (stage 2 without a part takes as long as with it) notes what it is asked, and has a figure for each variant
cat >"$W/stub" <<'END'
#!/bin/bash
echo "$*" >>"$LOG"
case $* in *"$STOP"*) [ -n "$STOP" ] && exit 1 ;; esac
if [ "$1" = fit ]; then
    [[ $* != *--stage2* || $(cat "$4.ckpt") = trained ]] || exit 1
    if [[ $* = *--stage2* ]]; then echo changed; else echo trained; fi >"$4.ckpt"
    echo "${*:5}" >"$4"
    echo '{"seconds": 1.0}'
elif [[ $* = *--factors* ]]; then
    echo '{"scene": "s", "albedo_psnr": 17.500, "sun_median_deg": 11.50}'
else
    echo "{\"photos\": [{\"name\": \"a\", \"fixed\": {\"psnr\": 1.0, \"ssim\": 1.0, \"flip\": 1.0}}], \"mean\": {\"fixed\": {\"psnr\": 1$(grep -c without "$4")$(grep -c tone "$4").25, \"ssim\": 0.5, \"flip\": 3e-01}, \"float\": {\"psnr\": 1}}, \"mean_full\": {\"fixed\": {\"psnr\": 19.5, \"ssim\": 0.6, \"flip\": 0.2}}}"
fi
END
chmod +x "$W/stub"
mkdir -p "$W/shop/gt"
echo '{}' >"$W/shop/gt/photo_params.json"
echo trained >"$W/shop.ckpt"
rm -rf build/ablation/shop
ablate() { ABLATION_TRAIN=$W/stub LOG=$W/calls STOP=$1 tests/ablation.sh "$B" "$W/shop" ${2-"$W/shop.ckpt"} >"$W/out" 2>"$W/err"; }
calls() { local n; n=$(wc -l <"$W/calls"); : >"$W/calls"; [ "$n" = "$1" ] || fail "ablation.sh: $n calls, not $1: $2"; }
: >"$W/calls"
ablate 'visibility.oriel --factors' && fail "ablation.sh: a variant failed, it did not"
calls 15 "stopped within the fifth variant"
[ ! -e build/ablation/shop/ablation.tsv ] || fail "ablation.sh: half a table"
ablate '' || fail "ablation.sh: $(cat "$W/out" "$W/err")"
calls 10 "goes on where it was stopped"
ablate '' || fail "ablation.sh: $(cat "$W/out" "$W/err")"
calls 0 "all is there"
rm build/ablation/shop/without_tone.fit.json
ablate '' || fail "ablation.sh: $(cat "$W/out" "$W/err")"
grep -q -- "fit $W/shop -o build/ablation/shop/without_tone.oriel --stage2 --without tone --json" "$W/calls" || fail "ablation.sh: $(cat "$W/calls")"
calls 1 "one file was removed"
printf 'variant\tpsnr\tssim\tflip\tpsnr_full\talbedo_psnr\tsun_median_deg\trelit_psnr\n' >"$W/want"
for v in full 'light paper' 'without tone' 'without shadow' 'without visibility' 'without ground' 'without distill' 'without sky-prior'; do
    case $v in *tone) psnr=111.25 ;; without*) psnr=110.25 ;; *) psnr=100.25 ;; esac
    printf '%s\t%s\t0.5\t3e-01\t19.5\t17.500\t11.50\t-\n' "$v" $psnr
done >>"$W/want"
cmp -s "$W/want" build/ablation/shop/ablation.tsv || fail "ablation.sh: $(cat build/ablation/shop/ablation.tsv)"
json build/ablation/shop/ablation.json 0.variant 7.psnr 2.albedo_psnr 1.sun_median_deg
grep -q relit_psnr build/ablation/shop/ablation.json && fail "ablation.sh: a figure that was not measured"
[ "$(find build/ablation/shop -name '*.ckpt' -o -name '*part*')" = "" ] && [ "$(cat "$W/shop.ckpt")" = trained ] || fail "ablation.sh: left behind: $(ls build/ablation/shop)"
cp build/ablation/shop/ablation.tsv "$W/eight.tsv"
: >"$W/calls"
rm -rf build/ablation/shop
ABLATION_VARIANTS=full ablate '' '' || fail "ablation.sh: $(cat "$W/out" "$W/err")"
calls 4 "a fit of its own, and one variant"
[ "$(cat build/ablation/shop/fit.oriel.ckpt)" = trained ] || fail "ablation.sh: its own fit is spoilt"
rm -rf build/ablation/shop
expect 2 'usage: tests/ablation.sh' tests/ablation.sh "$B"
# the program itself, on the variant that is always there
rm -rf build/ablation/place
ABLATION_VARIANTS=full ABLATION_STAGE2="--preset demo --threads 2 --rounds 2" ABLATION_EVAL="--limit 1" tests/ablation.sh "$B" "$place" "$W/ref.oriel.ckpt" >"$W/out" 2>"$W/err" || fail "ablation.sh: $(tail -3 "$W/err")"
[ "$(wc -l <build/ablation/place/ablation.tsv)" = 2 ] && tail -1 build/ablation/place/ablation.tsv | grep -qE $'^full(\t[0-9.]+){4}(\t-){3}$' || fail "ablation.sh: $(cat build/ablation/place/ablation.tsv)"
rm -rf build/ablation/place

# report
count() { grep -o -- "$1" "$W/report.html" | wc -l; }
# report ARTICLES PICTURES [OPTION...]
report() {
    "$T" report "$place" --scene "$W/ref.oriel" -o "$W/report.html" "${@:3}" >"$W/out" 2>"$W/err" || fail "report: $(cat "$W/err")"
    [ "$(count '<article>')" = "$1" ] && [ "$(count '<img ')" = "$2" ] || fail "report ${*:3}: $(count '<article>') photos, $(count '<img ') pictures"
    for part in base\ colour normals shading sun\&#39\;s\ visibility learned\ shadow depth 'sky map found; ring: sun'; do
        [ "$(count "<figcaption>$part</figcaption>")" -ge "$1" ] || fail "report ${*:3}: no $part"
    done
    for what in Sun Sky Tone; do [ "$(grep -c "<dt>$what</dt>" "$W/report.html")" -ge "$1" ] || fail "report ${*:3}: no $what in words"; done
}
report 1 16 --limit 1 --train 0
grep -q 'id="train"' "$W/report.html" && fail "report --train 0: training photos"
grep -q 'id="ablation"' "$W/report.html" && fail "report: ablations out of nothing"
grep -q 'id="skies"' "$W/report.html" && fail "report: skies out of nothing"
{ printf '#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 8\n'; printf 'dddd%.0s' $(seq 64); } >"$W/even.hdr"
report 1 19 --limit 1 --train 0 --sky "$W/even.hdr" --sky "$W/even.hdr"
[ "$(count '<figcaption>even.hdr, no sun</figcaption>')" = 2 ] && grep -q 'id="skies"' "$W/report.html" || fail "report --sky: no picture under it"
report $((1 + photos)) $((6 + 10 * (1 + photos))) --limit 1 --train 99
awk '{ print $1 == "variant" ? $0 : NR == 4 ? "<b>&\t12.5\t.5\t.5\t12\t-\t-\t-" : $0 }' "$W/eight.tsv" >"$W/shop.tsv"
report 4 46 --train 2 --ablation "$W/shop.tsv"
[ "$(count '<svg')" = 3 ] || fail "report: $(count '<svg') curves"
# the middle ones of two halves of the training photos
names=$(cd "$place/photos" && ls | grep -v test)
for i in 2 5; do grep -q "photo[0-9]*\">$(sed -n ${i}p <<<"$names")</a>" "$W/report.html" || fail "report: training photos $(grep '<h3' "$W/report.html")"; done
# 8 variants; the third, renamed, is 87.75 dB worse than full and of unknown meaning; base colour, but no other skies
sed -n '/class="ablation"/,/<\/table>/p' "$W/report.html" >"$W/table"
[ "$(grep -c '<tr' "$W/table")" = 9 ] && [ "$(grep -c 'class="worse"' "$W/table")" = 1 ] && [ "$(grep -c 'class="better"' "$W/table")" = 6 ] && grep -q '<b>&lt;b&gt;&amp;</b>.*<td>12.50</td><td>-87.75</td>.*width:50.0%' "$W/table" &&
    grep -q '17.50 <small>+0.00</small>' "$W/table" && ! grep -q 'other skies' "$W/table" || fail "report --ablation: $(cat "$W/table")"
grep -qE '<(script|link|iframe|object)|(src|href)="https?:|url\(|@import' "$W/report.html" && fail "the report fetches or runs something"
grep -qiE '(>|[-+ :])(nan|inf)[^a-z]' <(sed 's/base64,[^"]*//g' "$W/report.html") && fail "the report shows what is no number"
if command -v python3 >/dev/null; then
    python3 - "$W/report.html" <<'END' || fail "report: markup"
import base64, html.parser, re, sys
page = open(sys.argv[1]).read()
for code in re.findall(r'base64,([^"]*)', page): assert base64.b64decode(code, validate=True)[:2] == b'\xff\xd8'
stack, ids, links, alts = [], [], [], []
class Check(html.parser.HTMLParser):
    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        if 'id' in attrs: ids.append(attrs['id'])
        if tag == 'a': links.append(attrs['href'])
        if tag == 'img': alts.append(attrs['alt'])
        if tag not in ('meta', 'img'): stack.append(tag)
    def handle_endtag(self, tag):
        assert stack.pop() == tag, tag
Check().feed(page)
assert not stack, stack
assert len(ids) == len(set(ids)) and {'scores', 'training', 'ablation', 'surface', 'test', 'train', 'legend'} <= set(ids), ids
assert len(links) >= 7 and all(l[0] == '#' and l[1:] in ids for l in links), links
assert all(re.match(r'\S+: \S', a) for a in alts), alts
END
fi
if command -v tidy >/dev/null; then
    tidy -e -q --drop-empty-elements no "$W/report.html" >"$W/tidy" 2>&1
    [ ! -s "$W/tidy" ] || fail "report: $(head -3 "$W/tidy")"
fi
ls "$W"/*.part* "$W"/*.tmp* "$W"/no.* >/dev/null 2>&1 && fail "left behind: $(ls "$W")"
expect 1 'nothing: no such folder' "$T" report "$W/nothing" --scene "$W/ref.oriel" -o "$W/no.html"
expect 2 'limit' "$T" report "$place" --scene "$W/ref.oriel" -o "$W/no.html" --limit 0
expect 2 'train' "$T" report "$place" --scene "$W/ref.oriel" -o "$W/no.html" --train -1
sed 4s/12.5/12,5/ "$W/shop.tsv" >"$W/bad.tsv"
expect 1 'bad.tsv: line 4: column 2: a number' "$T" report "$place" --scene "$W/ref.oriel" -o "$W/no.html" --ablation "$W/bad.tsv"
expect 1 'none.hdr' "$T" report "$place" --scene "$W/ref.oriel" -o "$W/no.html" --sky "$W/none.hdr"
expect 2 'at most 12' "$T" report "$place" --scene "$W/ref.oriel" -o "$W/no.html" $(printf -- "--sky x%.0s " $(seq 13))
expect 1 'none.tsv' "$T" report "$place" --scene "$W/ref.oriel" -o "$W/no.html" --ablation "$W/none.tsv"
[ ! -e "$W/no.html" ] || fail "report: a page out of a bad table"

# curves: one fit, made once
grep -q . tests/curves.sh && (rm -rf build/curves/place; export CURVES_OURS="--preset demo --cells 64 --threads 2 --steps 20 --rounds 2" CURVES_ENCODINGS=
for i in 1 2; do tests/curves.sh "$B" "$place" >"$W/curves" 2>"$W/err" || exit 1; cp build/curves/place/curves.tsv "$W/curves.$i"; done
[ "$(wc -l <"$W/curves.1")" = 2 ] && cmp -s "$W/curves.1" "$W/curves.2" && grep -q '<svg' build/curves/place/curves.svg) || fail "curves.sh: $(cat "$W/curves" "$W/err")"
rm -rf build/curves/place
"$T" eval "$place" --baselines-only --limit 1 --json >"$W/base.json" 2>"$W/err" || fail "eval --baselines-only: $(cat "$W/err")"
json "$W/base.json" mean.median_warp.psnr
# what is scored cannot be seen: the right half painted over (in PNG: nothing bleeds), no pixel of a prediction changes; painting on the left changes them
if command -v oiiotool >/dev/null; then
    for copy in plain right left; do
        mkdir -p "$W/$copy"
        cp -r "$place/sparse" "$place/sparse_test" "$place/split.tsv" "$W/$copy"
        sed -i 's/test_000\.jpg/test_000.png/' "$W/$copy"/split.tsv "$W/$copy"/sparse_test/0/images.txt
        cp -r "$place/photos" "$W/$copy"
        rm "$W/$copy/photos/test_000.jpg"
        read -r w h <<<"$(oiiotool --info "$place/photos/test_000.jpg" | sed -E 's/.*: *([0-9]+) x +([0-9]+),.*/\1 \2/')"
        half=$((w / 2))
        case $copy in plain) box= ;; right) box="--fill:color=1,0,0.7 $((w - half))x$h+$half+0" ;; left) box="--fill:color=1,0,0.7 10x$h+$((half - 10))+0" ;; esac
        oiiotool "$place/photos/test_000.jpg" $box -o "$W/$copy/photos/test_000.png" 2>"$W/err" || fail "oiiotool: $(cat "$W/err")"
        "$T" eval "$W/$copy" --scene "$W/ref.oriel" --nerfw "$W/a.nerfw" --photo test_000.png --out "$W/$copy/sheets" >"$W/out" 2>"$W/err" || fail "eval: $(cat "$W/err")"
        diff() { oiiotool "$W/plain/sheets/test_000.png" --cut "$1" "$W/$copy/sheets/test_000.png" --cut "$1" --diff 2>&1 | grep -oE 'PASS|FAILURE'; }
        if [ $copy = right ]; then
            [ "$(diff "${w}x$h+0+0")" = FAILURE ] || fail "eval's sheet does not show the photo"
            [ "$(diff "$((6 * (w + 4) - 4))x$h+$((w + 4))+0")" = PASS ] || fail "eval saw the right half"
        elif [ $copy = left ]; then
            for column in 1 2 3 4 5 6; do       # fixed, float, nerfw, row_mean, nearest_warp, median_warp
                [ "$(diff "${w}x$h+$((column * (w + 4)))+0")" = FAILURE ] || fail "column $column of eval did not see the left half"
            done
        fi
    done
else
    echo "train.sh: no oiiotool here: the check that eval cannot see what it scores left out"
fi

# masks: beside given ones, and as pictures
expect 1 'no masks to check against' "$T" masks "$other" --check
"$T" masks "$place" --check --json -o "$W/masks" >"$W/masks.json" 2>"$W/err" || fail "masks --check: $(cat "$W/err")"
json "$W/masks.json" photos.0.sure.iou mean.sure.precision mean.sure.recall mean.likely.iou
[ "$(ls "$W/masks" | wc -l)" = $((photos + 2)) ] || fail "masks -o wrote $(ls "$W/masks")"
if command -v python3 >/dev/null; then
    python3 -c 'import json, sys; m = json.load(open(sys.argv[1]))["mean"]["likely"]; sys.exit(m["iou"] < 0.85)' "$W/masks.json" || fail "masks: $(tail -c 300 "$W/masks.json")"
fi

# sky: no panorama, a broken one, two of the real ones
mkdir "$W/sky"
expect 1 'sky: no .hdr or .exr' "$T" sky "$W/sky" -o "$W/sky.oriel"
expect 1 'nothing: no such' "$T" sky "$W/nothing" -o "$W/sky.oriel"
echo 'no panorama' >"$W/sky/broken.hdr"
"$T" sky "$W/sky" -o "$W/sky.oriel" >"$W/out" 2>"$W/err"
[ $? = 1 ] && grep -q 'broken.hdr' "$W/err" && [ ! -e "$W/sky.oriel" ] || fail "sky of a broken panorama: $(cat "$W/err")"
if ls ../shared/data/sky/*.hdr >/dev/null 2>&1; then
    cp ../shared/data/sky/{noon_grass_1k,pmndrs_sky}.hdr "$W/sky"
    "$T" sky "$W/sky" -o "$W/sky.oriel" --json >"$W/sky.json" 2>"$W/err" || fail "sky: $(cat "$W/err")"
    grep -q 'left out: .*broken.hdr' "$W/err" || fail "sky: the broken panorama is not named: $(cat "$W/err")"
    json "$W/sky.json" panoramas held_out rms bytes
    "$B/oriel" info "$W/sky.oriel" | grep -q SKYD || fail "info of a sky"
    "$T" fit "$place" -o "$W/x.oriel" $short --sky "$W/sky.oriel" >/dev/null 2>"$W/err" || fail "fit --sky: $(tail -3 "$W/err")"
else
    echo "train.sh: no ../shared/data/sky here: real panoramas left out"
fi

# usage: 2
for c in fit eval sky masks mesh plot report bench; do
    "$T" $c --help >"$W/out" 2>"$W/err" && [ ! -s "$W/err" ] && grep -qi "usage: oriel-train $c" "$W/out" || fail "$c --help"
    "$T" $c --frobnicate >"$W/out" 2>"$W/err"
    [ $? = 2 ] && [ ! -s "$W/out" ] && grep -q -- "--frobnicate" "$W/err" || fail "$c --frobnicate"
done
"$T" fit --help | grep -q -- --checkpoint-seconds || fail "fit --help"
"$T" fit "$place" >"$W/out" 2>"$W/err"
[ $? = 2 ] || fail "fit without -o"
"$T" sky "$W/sky" >"$W/out" 2>"$W/err"
[ $? = 2 ] || fail "sky without -o"
expect 2 'no such command' "$T" frobnicate
expect 2 'demo, quick, standard or full' "$T" fit "$place" -o "$W/x.oriel" --preset huge
for o in "--steps 1.5" "--rounds x" "--cells 63" "--seed -1" "--time-budget nan"; do
    expect 2 "${o%% *}: ${o#* } is out of range" "$T" fit "$place" -o "$W/x.oriel" $o
done
expect 2 '--checkpoint-seconds: x is out of range (0 to' "$T" fit "$place" -o "$W/x.oriel" --checkpoint x
expect 2 'scene' "$T" eval "$place"
expect 2 'range' "$T" eval "$place" --scene "$W/ref.oriel" --limit x
"$T" >"$W/out" 2>"$W/err"
[ $? = 2 ] && [ ! -s "$W/out" ] || fail "no command: not exit 2"
exit $bad
