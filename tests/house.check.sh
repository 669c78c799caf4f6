#!/bin/bash
# The house rules that a compiler does not check: public headers stand alone, folders are entered through include/oriel only, no "../" includes.
set -u
bad=0
for h in include/oriel/*.h; do
    for cc in gcc clang; do
        command -v $cc >/dev/null || continue
        $cc -std=c11 -Wall -Wextra -Werror -Iinclude -fsyntax-only -x c "$h" || { echo "$h does not compile alone under $cc"; bad=1; }
    done
done
forbid() { # FOLDER PATTERN
    if grep -nE "^#include \"$2" -r "$1" --include='*.[ch]' --include='*.cpp'; then echo "$1 may not include $2"; bad=1; fi
}
forbid formats '(trainer|runtime|tests)/'
forbid runtime '(trainer|formats|tests)/'
forbid trainer '(runtime|formats|tests)/'
forbid include '(trainer|runtime|formats|tests)/'
forbid . '\.\./'
if grep -nE '\b(exp|log|sin|cos|tan|atan2?|asin|acos|pow|exp2|log2)f?\(' -r runtime formats --include='*.c' | grep -vE 'orl_|^\S+: *(\*|/\*|//)' ; then echo "libm functions differ between machines: use oriel/math.h"; bad=1; fi
exit $bad
