#!/bin/bash
# Hostile photo collections (tests/tools/stress.c): each becomes a usable scene, or is refused in one line that leaves nothing behind. The table goes to BUILD/stress.txt.
# $1: build folder; then cases, default all (an ASan build: those that look for trouble in memory)
set -u
B=${1:-build/host}
W=$(mktemp -d)
trap 'rm -rf "$W"' EXIT
bad=0
fail() { echo "stress.sh: $*"; bad=1; }
for format in jpeg png; do
    "$B/oriel" --version | grep '^images:' | grep -q $format || { echo "stress.sh: skipped, built without ${format^^}"; exit 77; }
done
"$B/tools/attraction" --photos=5 --tests=1 --width=64 --frames=0 --points=600 --masks "$W/base" >"$W/out" || exit 1
mv "$W/base/gt/masks" "$W/base/masks"
refused=" one nopoints onepoint pixel1 pixel2 focals photosize masksize away "
cases=("${@:2}")
[ ${#cases[@]} = 0 ] && case $B in *-san) cases=(base far wild line pixel2 strip away sightings) ;; *) mapfile -t cases < <("$B/tools/stress" --list) ;; esac
base=
row() { printf '%-11s %-8s %8s %8s  %s\n' "$@" >>"$B/stress.txt"; }
: >"$B/stress.txt"
row case outcome stage1 test 'error (stage 1: dB on the training photos; test: dB, right half of the test photo)'
for c in "${cases[@]}"; do
    s=$W/$c.scene
    "$B/tools/stress" "$W/base" "$s" "$c" || { fail "$c cannot be made"; continue; }
    "$B/oriel-train" fit "$s" -o "$W/$c.oriel" --preset demo --cells 64 --threads 2 --steps 16 --rounds 2 --json >"$W/json" 2>"$W/err"
    code=$?
    grep -qiE '[^a-z](nan|-?inf)[^a-z]' "$W/err" "$W/json" && fail "$c: what is printed is not finite: $(cat "$W/err" "$W/json")"
    if [ $code = 0 ]; then
        stage1=$(grep -o 'stage 1 .*PSNR [-0-9.]*' "$W/err" | tail -1 | sed 's/.*PSNR //')
        "$B/oriel-train" eval "$s" --scene "$W/$c.oriel" >"$W/out" 2>"$W/err" || fail "$c: eval: $(tail -1 "$W/err")"
        test=$(awk '$1 ~ /^test_/ { print $2 }' "$W/out")
        [[ $test =~ ^[0-9.]+$ && $stage1 =~ ^[-0-9.]+$ ]] || fail "$c: stage 1 ${stage1:-?} dB, test photo ${test:-?} dB"
        grep -q '"dropped_steps": 0' "$W/json" || fail "$c: steps were dropped: $(cat "$W/json")"
        row "$c" usable "$stage1" "$test" ''
        [ "$c" = base ] && base=$test
        case $c in large|small|origin) awk "BEGIN { d = $test - ${base:-$test}; exit d * d > 0.3 * 0.3 }" || fail "$c: $test dB, the same scene untouched $base" ;; esac
    else
        row "$c" refused '' '' "$(tail -1 "$W/err" | sed "s,$W/,,g")"
        [ $code = 1 ] && [ "$(grep -c '^oriel-train: .*[^t]$' "$W/err")" -ge 1 ] && tail -1 "$W/err" | grep -q "^oriel-train: .*$c.scene" || fail "$c: exit $code: $(tail -3 "$W/err")"
        ls "$W/$c".oriel* >/dev/null 2>&1 && fail "$c: a refusal left $(ls "$W/$c".oriel*)"
    fi
    [[ $refused = *" $c "* ]] && want=1 || want=0
    [ $code = $want ] || fail "$c: exit $code, not $want: $(tail -1 "$W/err")"
    rm -rf "$s" "$W/$c.oriel"*
done
exit $bad
