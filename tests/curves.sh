#!/bin/bash
# Right-half PSNR against CPU minutes, a figure for each SCENE: Oriel (fits of growing effort) beside `fit --method nerfw` with our encoding and the textbook's (one fit each, snapshots on the way).
#   tests/curves.sh BUILD SCENE...      -> build/curves/NAME/curves.tsv, curves.svg, and how much sooner Oriel reaches the textbook encoding's final PSNR
# What is in build/curves is not made again: a run that was stopped goes on. Remove a file there to have it made anew. Settings, from the environment:
#   CURVES_OURS         a fit's options a line                                CURVES_ENCODINGS    "ours textbook"; "" leaves the baseline out
#   CURVES_SNAPSHOTS    minutes at which the baseline is scored, rising       CURVES_NERFW        the baseline's options
#   CURVES_EVAL         eval's options
set -eu -o pipefail
T=$1/oriel-train
shift
ours=${CURVES_OURS:-"--preset demo --long-side 240 --steps 300 --rounds 10
--preset demo --steps 400 --rounds 10
--preset quick --steps 800 --rounds 12
--preset quick
--preset standard"}
encodings=${CURVES_ENCODINGS-"ours textbook"}
snapshots=${CURVES_SNAPSHOTS:-1,2,4,8,16,32}
nerfw=${CURVES_NERFW:---preset standard --time-budget ${snapshots##*,}}
[ $# -gt 0 ] || { echo "usage: tests/curves.sh BUILD SCENE..." >&2; exit 2; }

number() { grep -oE "\"$2\": [-0-9.e+]+" "$1" | head -1 | grep -oE '[-0-9.e+]+$'; }                              # FILE KEY
psnr() { grep -oE '"mean": \{.*"mean_full"' "$1" | grep -oE "\"$2\": \{\"psnr\": [-0-9.e+]+" | grep -oE '[-0-9.e+]+$'; }    # FILE COLUMN
made() { [ -s "$1" ] || { "${@:2}" >"$1.part" && mv "$1.part" "$1"; }; }                                           # FILE COMMAND...: its output, once

# FILE OPTION...: a fit; goes on from its checkpoint if it was stopped
fit_ours() {
    local resume=()
    [ -s "$1.oriel.ckpt" ] && resume=(--resume)
    "$T" fit "$scene" -o "$1.oriel" "${@:2}" "${resume[@]}" --json
}

for scene; do
    name=$(basename "$(realpath "$scene")")
    dir=build/curves/$name
    mkdir -p "$dir"
    table=$dir/curves.tsv
    printf 'series\tCPU minutes\tPSNR of the right half, dB\n' >"$table.part"
    while read -r options; do
        [ -n "$options" ] || continue
        f=$dir/oriel$(tr -cs 'A-Za-z0-9\n' _ <<<" $options")
        echo "== $name: fit $options"
        # shellcheck disable=SC2086
        made "$f.fit.json" fit_ours "$f" $options
        made "$f.eval.json" "$T" eval "$scene" --scene "$f.oriel" ${CURVES_EVAL:-} --json
        printf 'Oriel\t%s\t%s\n' "$(awk "BEGIN { print $(number "$f.fit.json" cpu_seconds) / 60 }")" "$(psnr "$f.eval.json" fixed)" >>"$table.part"
    done <<<"$ours"
    for encoding in $encodings; do
        f=$dir/nerfw_$encoding
        echo "== $name: fit --method nerfw --encoding $encoding"
        # shellcheck disable=SC2086
        made "$f.fit.json" "$T" fit "$scene" -o "$f" --method nerfw --encoding "$encoding" --snapshots "$snapshots" $nerfw --json
        for m in ${snapshots//,/ }; do
            [ -s "$f.${m}m" ] || continue
            made "$f.${m}m.eval.json" "$T" eval "$scene" --nerfw "$f.${m}m" ${CURVES_EVAL:-} --json
            # a snapshot is named by the clock; CPU time goes with it
            printf 'NeRF-W, %s encoding\t%s\t%s\n' "$encoding" "$(awk "BEGIN { print $m * $(number "$f.fit.json" cpu_seconds) / $(number "$f.fit.json" seconds) }")" "$(psnr "$f.${m}m.eval.json" nerfw)" >>"$table.part"
        done
    done
    { head -1 "$table.part"; tail -n +2 "$table.part" | sort -t"$(printf '\t')" -k1,1r -k2,2g; } >"$table"
    rm "$table.part"
    "$T" plot "$table" -o "$dir/curves.svg" --log-x --title "$name"
    column -ts "$(printf '\t')" "$table" 2>/dev/null || cat "$table"
    # The time at which a rising curve first reaches the textbook's last PSNR: between two points, on the line (logarithm of time).
    awk -F'\t' -v name="$name" '
        NR == 1 { n = 0; next }
        $1 ~ /textbook/ { goal = $3; last = $2 }
        $1 == "Oriel" { x[n] = $2; y[n++] = $3 }
        END {
            if (last == "" || !n) exit
            for (i = 0; i < n && y[i] < goal; i++) { }
            if (i == n) { printf "%s: ours does not reach the textbook encoding'\''s %.2f dB: %.2f at most\n", name, goal, y[n - 1]; exit }
            t = x[i]
            if (i) t = exp(log(x[i - 1]) + (log(x[i]) - log(x[i - 1])) * (goal - y[i - 1]) / (y[i] - y[i - 1]))
            printf "%s: ours reaches the textbook encoding'\''s final %.2f dB (%.1f CPU minutes) %s%.1f times sooner\n", name, goal, last, i ? "" : "at least ", last / t
        }' "$table"
    echo "$dir/curves.svg"
done
