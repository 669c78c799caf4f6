#!/bin/bash
# Benchmarks of a build folder: each prints ratios measured in one run.
set -u
for b in "$1"/tests/bench_*; do
    [[ -x $b && ! $b = *.d ]] || continue
    echo "== ${b##*/}"
    "$b" || exit 1
done
