#!/bin/bash
# What each part of the light model is worth: stage 2 again and again from one fit's geometry, each time without one of its parts, scored on the half-photo protocol (and on ground truth where the SCENE has it).
#   tests/ablation.sh BUILD SCENE [CHECKPOINT]      -> build/ablation/NAME/ablation.tsv (for `oriel-train report --ablation`) and ablation.json
# CHECKPOINT: of a finished fit of SCENE; without it one is made. What is in build/ablation is not made again: a run that was stopped goes on. Remove a file there to have it made anew. Settings, from the environment:
#   ABLATION_VARIANTS   a variant's options a line, "full" for none           ABLATION_FIT        options of the fit that is made
#   ABLATION_STAGE2     options of every stage 2 (--preset as in the fit)     ABLATION_EVAL       eval's options
#   ABLATION_TRAIN      the program, instead of BUILD/oriel-train
set -eu -o pipefail
if [ ! -d "${2:-}" ] || [ $# -gt 3 ]; then echo "usage: tests/ablation.sh BUILD SCENE [CHECKPOINT]; SCENE is a folder" >&2; exit 2; fi
T=${ABLATION_TRAIN:-$1/oriel-train} scene=$2 checkpoint=${3:-}
variants=${ABLATION_VARIANTS:-"full
--light paper
--without tone
--without shadow
--without visibility
--without ground
--without distill
--without sky-prior"}
name=$(basename "$(realpath "$scene")")
dir=build/ablation/$name
mkdir -p "$dir"

made() { [ -s "$1" ] || { "${@:2}" >"$1.part" && mv "$1.part" "$1"; }; }                                           # FILE COMMAND...: its output, once
number() { { grep -oE "\"$2\": [-0-9.e+]+" "$1" || true; } | head -1 | grep -oE '[-0-9.e+]+$' || echo -; }         # FILE KEY; - if it is not there
score() { { grep -oE "\"$2\": \{\"fixed\": \{[^}]*\}" "$1" || true; } >"$dir/part"; number "$dir/part" "$3"; }     # FILE mean|mean_full KEY

# goes on from its checkpoint if it was stopped
fit_whole() {
    local resume=()
    [ -s "$checkpoint" ] && resume=(--resume)
    # shellcheck disable=SC2086
    "$T" fit "$scene" -o "$dir/fit.oriel" ${ABLATION_FIT:-} "${resume[@]}" --json
}

# FILE OPTION...: stage 2 from the fit's geometry; what was stopped half-way begins again
fit_stage2() {
    # shellcheck disable=SC2086
    cp --reflink=auto "$checkpoint" "$1.oriel.ckpt" && "$T" fit "$scene" -o "$1.oriel" --stage2 ${ABLATION_STAGE2:-} "${@:2}" --json
}

if [ -z "$checkpoint" ]; then
    checkpoint=$dir/fit.oriel.ckpt
    echo "== $name: fit ${ABLATION_FIT:-}"
    made "$dir/fit.json" fit_whole
fi
keys=(psnr ssim flip psnr_full albedo_psnr sun_median_deg relit_psnr)
(IFS=$'\t'; echo "variant	${keys[*]}") >"$dir/table.part"
rows=
while read -r options; do
    [ -n "$options" ] || continue
    variant=${options#--}
    f=$dir/${variant// /_}
    [ "$options" = full ] && options=
    echo "== $name: $variant"
    # shellcheck disable=SC2086
    made "$f.fit.json" fit_stage2 "$f" $options
    # shellcheck disable=SC2086
    made "$f.eval.json" "$T" eval "$scene" --scene "$f.oriel" ${ABLATION_EVAL:-} --json
    [ ! -f "$scene/gt/photo_params.json" ] || made "$f.factors.json" "$T" eval "$scene" --scene "$f.oriel" --factors --json
    rm -f "$f.oriel.ckpt"           # hundreds of megabytes, and its figures are taken
    values=("$(score "$f.eval.json" mean psnr)" "$(score "$f.eval.json" mean ssim)" "$(score "$f.eval.json" mean flip)" "$(score "$f.eval.json" mean_full psnr)")
    for key in "${keys[@]:4}"; do
        if [ -s "$f.factors.json" ]; then values+=("$(number "$f.factors.json" "$key")"); else values+=(-); fi
    done
    (IFS=$'\t'; echo "$variant	${values[*]}") >>"$dir/table.part"
    row="{\"variant\": \"$variant\""
    for i in "${!keys[@]}"; do [ "${values[i]}" = - ] || row+=", \"${keys[i]}\": ${values[i]}"; done
    rows+="${rows:+,$'\n'}  $row}"
done <<<"$variants"
printf '[\n%s\n]\n' "$rows" >"$dir/ablation.json"
mv "$dir/table.part" "$dir/ablation.tsv"
rm -f "$dir/part"
column -ts "$(printf '\t')" "$dir/ablation.tsv" 2>/dev/null || cat "$dir/ablation.tsv"
echo "$dir/ablation.tsv"
