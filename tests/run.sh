#!/bin/bash
# Runs every test program and script of a build folder; ends with one line `N passed, M failed, K skipped`.
set -u
build=$1
passed=0 failed=0 skipped=0
export ORIEL_BUILD=$build
export ASAN_OPTIONS=detect_leaks=1

for t in "$build"/tests/test_*; do
    [[ -x $t && ! $t = *.d ]] || continue
    echo "== ${t##*/}"
    log=$build/${t##*/}.log
    timeout 900 "$t" >"$log" 2>&1
    code=$?
    ok=$(grep -c '^\[       OK \]' "$log"); bad=$(grep -c '^\[  FAILED  \] [a-z]' "$log"); skip=$(grep -c '^\[  SKIPPED \] [a-z]' "$log")
    [ $code != 0 ] && [ "$bad" = 0 ] && bad=1
    # cmocka lists failures and skips a second time at the end
    grep -q 'FAILED TEST(S)' "$log" && bad=$(grep -oE '^ *[0-9]+ FAILED TEST' "$log" | grep -oE '[0-9]+' | tail -1)
    passed=$((passed + ok)) failed=$((failed + bad)) skipped=$((skipped + skip))
    if [ "$bad" != 0 ]; then cat "$log"; else grep -hE 'seed|skip|figure' "$log" | head -8; fi
done

for s in tests/*.check.sh tests/cli/*.sh; do
    [ -f "$s" ] || continue
    echo "== ${s##*/}"
    bash "$s" "$build"
    case $? in
        0) passed=$((passed + 1)) ;;
        77) skipped=$((skipped + 1)) ;;
        *) failed=$((failed + 1)); echo "FAILED: $s" ;;
    esac
done

echo "$passed passed, $failed failed, $skipped skipped"
[ $failed = 0 ]
