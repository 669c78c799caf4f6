# What the scripts of this folder share: a folder of their own in $W, fail, expect. Sourced; $bad is 1 once something failed.
W=$(mktemp -d)
trap 'rm -rf "$W"' EXIT
bad=0
fail() { echo "${0##*/}: $*"; bad=1; }

# quiet FILE: the lines that expect counts
quiet() { cat "$1"; }

# expect CODE PATTERN COMMAND...: exit code, and one line on standard error that matches
expect() {
    local code=$1 pattern=$2 got lines
    shift 2
    "$@" >"$W/out" 2>"$W/err"
    got=$?
    lines=$(quiet "$W/err" | wc -l)
    [ $got = "$code" ] || fail "exit $got, not $code: $* ($(head -c 300 "$W/err"))"
    [ "$lines" = 1 ] || fail "$lines lines, not 1, on standard error: $*: $(head -c 300 "$W/err")"
    quiet "$W/err" | grep -q -- "$pattern" || fail "no '$pattern' from $*: $(head -c 300 "$W/err")"
}
