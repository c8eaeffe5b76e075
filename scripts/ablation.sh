#!/usr/bin/env bash
# What each departure of the preset `water` of `isph-paper` does: one run for each variant, one table (Markdown).
#
# scripts/ablation.sh [CASE] [DIR]   default dam-break-20, runs/ablation; DIR must not exist yet
set -euo pipefail
cd "$(dirname "$0")/.."
case=${1:-dam-break-20}
dir=${2:-runs/ablation}
if [ -e "$dir" ]; then
    echo "$dir exists already; name another folder" >&2
    exit 2
fi
cargo build --quiet --release
greenwater=target/release/greenwater

# value FILE KEY FORMAT: the number in the first line `"KEY": number` of a file of one key a line; a dash where there is none.
value() {
    local found
    found=$(sed -n "s/^ *\"$2\": \([-+.0-9eE]*\),*$/\1/p" "$1" | head -n 1)
    if [ -n "$found" ]; then printf "$3" "$found"; else printf -- -; fi
}

# variant TITLE KEY=VALUE...: runs it and prints its row.
variant() {
    local title=$1 run status=0 settings=()
    shift
    run="$dir/$((++count))"
    for setting in "$@"; do
        settings+=(--set "$setting")
    done
    "$greenwater" run "$case" --set method.name=isph-paper "${settings[@]}" --out "$run" >"$dir/$count.txt" 2>&1 || status=$?
    if [ ! -f "$run/summary.json" ]; then
        cat "$dir/$count.txt" >&2
        exit 1
    fi
    local end
    if [ "$status" = 0 ]; then end="done"; else end="exit $status"; fi
    local summary="$run/summary.json"
    echo "| $title | $end | $(value "$summary" end_time %.3f) | $(value "$summary" lost_particles %d) |" \
        "$(value "$summary" max_rise %.3g) | $(value "$summary" pressure_noise %.3g) |"
}

mkdir -p "$dir"
count=0
echo "| variant of \`isph-paper\` on $case | end | reached, s | lost | greatest rise of energy over the start | pressure noise |"
echo "|---|---|---|---|---|---|"
variant "\`paper\`" method.preset=paper
variant "\`paper\`, fixed step of 1 ms" method.preset=paper time.step=0.001
variant "\`water\`, \`wall_guard = \"none\"\`" method.wall_guard=none
variant "\`water\`, \`alpha = 0\`" method.alpha=0.0
variant "\`water\`"
