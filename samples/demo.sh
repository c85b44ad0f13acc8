#!/usr/bin/env bash
# What carla-recap is for, from a simulated crash to its pictures. Run it with `make demo`.
set -euo pipefail
cd "$(dirname "$0")/.."

say() {
    printf '\n# %s\n' "$*"
}

run() {
    printf '$ %s\n' "$*"
    "$@"
}

out=build/demo
mcap=$out/crash.mcap
mkdir -p "$out"
rm -rf "$out"/{crash,crossing,avoided,foxglove}.* "$out/page"
export SOURCE_DATE_EPOCH=1767261600 # the date that the recordings get

simulates=true
python -c 'import carla' 2>/dev/null || simulates=false # its library is not for every machine, nor Python
if $simulates; then
    say 'A simulated minute: the hero runs over a walker, and into a van that blocks its lane. The same seed, the same bytes.'
    run carla-recap record "$mcap" --crash --vehicles 12 --walkers 8 --seed 7 --additional-data
else
    say "Simulating needs CARLA's library (Python up to 3.12, on Linux or Windows); here is what was simulated before."
    run cp samples/crash.mcap "$mcap"
fi

say 'Who collided with whom?'
run carla-recap collisions "$mcap"

say 'Who stood still for 30 s or more? Both cars of the crash; and the spectator, which CARLA counts, too.'
run carla-recap blocked "$mcap"

if $simulates; then
    say 'What if the autopilot had taken over 11 s into it, one second before the crash? Nobody is hit.'
    run carla-recap replay "$mcap" "$out/avoided.mcap" --duration 11 --then 15
    run carla-recap collisions "$out/avoided.mcap"
fi

say 'From a CARLA log to MCAP and back: not a byte is lost.'
run carla-recap convert samples/crossing.log "$out/crossing.mcap"
run carla-recap convert "$out/crossing.mcap" "$out/crossing.log"
run cmp samples/crossing.log "$out/crossing.log"

say 'To look at: what went wrong, as a page of plain files; for the Rerun viewer, behind the hero; for Foxglove.'
run carla-recap report "$mcap" "$out/page"
run carla-recap export "$mcap" "$out/crash.rrd"
run carla-recap export "$mcap" "$out/foxglove.mcap"

hint() {
    printf '%-52s # %s\n' "$1" "$2"
}

say "All is in $out. How to look at it, with .venv/bin on the PATH:"
hint "$out/page/index.html" 'the incident page: open it in any browser'
hint "rerun $out/crash.rrd" "Rerun's viewer; or: carla-recap view $mcap --web"
hint "$out/foxglove.mcap" 'open it in Foxglove, with the layout that is named above'
hint "carla-recap snapshot $mcap crash.png --at 12" 'a picture, with no display'
say 'And to ask:'
hint "carla-recap collisions $mcap --types hv" "only the hero's, with vehicles"
hint "carla-recap blocked $mcap --min-time 5" 'who waited, too'
hint "carla-recap info $mcap --all" 'every record of every frame'
hint 'carla-recap convert YOUR.log YOUR.mcap' 'a recording of yours'
