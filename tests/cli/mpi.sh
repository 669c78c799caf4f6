#!/bin/bash
# A fit shared by two ranks over MPI: the same bytes as one rank with as many threads, errors of one rank end both. $1: build folder.
set -u
B=${1:-build/host}
T=$B/oriel-train
command -v mpirun >/dev/null || { echo "mpi.sh: skipped, no mpirun here"; exit 77; }
[ -f "$B/obj/trainer/ranks_mpi.o" ] || { echo "mpi.sh: skipped, built without MPI"; exit 77; }
W=$(mktemp -d)
trap 'rm -rf "$W"' EXIT
bad=0
fail() { echo "mpi.sh: $*"; bad=1; }
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1
run() { timeout 300 mpirun "$@"; }
run -n 2 true 2>/dev/null || { echo "mpi.sh: skipped, mpirun does not start processes here"; exit 77; }

"$B/tools/attraction" --photos=6 --tests=1 --width=64 --frames=0 --points=800 "$W/place" >/dev/null || exit 1
fit=(fit "$W/place" --preset demo --cells 64 --steps 30 --rounds 3)
"$T" "${fit[@]}" -o "$W/one.oriel" --threads 2 2>"$W/one.err" || fail "one rank: $(tail -1 "$W/one.err")"
run -n 2 "$T" "${fit[@]}" -o "$W/two.oriel" --threads 1 2>"$W/two.err" || fail "two ranks: $(tail -1 "$W/two.err")"
cmp "$W/one.oriel" "$W/two.oriel" || fail "two ranks differ from one"
[ "$(grep -c '^surface: ' "$W/two.err")" = 1 ] || fail "progress is not told once: $(cat "$W/two.err")"
[ -z "$(find "$W" -name '*.tmp*')" ] || fail "temporary files stay behind"

# resumed from the end of stage 2 as from a kill: both ranks read the checkpoint
run -n 2 "$T" "${fit[@]}" -o "$W/two.oriel" --threads 1 --stage2 2>"$W/again.err" || fail "--stage2: $(tail -1 "$W/again.err")"
cmp "$W/one.oriel" "$W/two.oriel" || fail "stage 2 redone by two ranks differs"

# a wrong folder on every rank, and on the second only, which the first would wait for
run -n 2 "$T" fit "$W/none" -o "$W/x.oriel" 2>"$W/err" && fail "a missing folder is no error"
[ "$(grep -c '^oriel-train: ' "$W/err")" = 1 ] || fail "not one line: $(cat "$W/err")"
run -n 1 "$T" "${fit[@]}" -o "$W/x.oriel" --threads 1 : -n 1 "$T" fit "$W/none" -o "$W/x.oriel" --threads 1 2>"$W/err" && fail "an error of the second rank is none"
grep -q "^oriel-train: $W/none" "$W/err" || fail "the second rank's error is not told: $(cat "$W/err")"
[ ! -e "$W/x.oriel" ] || fail "a failed run wrote a scene"
exit $bad
