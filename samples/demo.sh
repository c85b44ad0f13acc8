#!/usr/bin/env bash
# Simulate a crash, query it, film it, and make its incident page. Run it with `make demo`.
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
rm -rf "$out"/{crash,crossing,avoided,foxglove,compared}.* "$out/page.html"
export SOURCE_DATE_EPOCH=1767261600 # the date that the recordings get

simulates=true
python -c 'import pymunk' 2>/dev/null || simulates=false # the extra sim
if $simulates; then
    say 'Simulate a minute: the hero hits a walker, and then a van that blocks its lane. The same seed gives the same bytes.'
    run carla-recap record "$mcap" --crash --vehicles 12 --walkers 8 --seed 7 --additional-data
else
    say "Simulating needs the extra sim, which is missing: take a sample instead."
    run cp samples/crash.mcap "$mcap"
fi

say 'List the collisions.'
run carla-recap collisions "$mcap"

say 'List the actors that stood still for 30 s or more: both cars of the crash, and the spectator, which CARLA counts, too.'
run carla-recap blocked "$mcap"

if $simulates; then
    say 'Replay the first 11 s, then let the autopilot drive, one second before the crash: no vehicle collides.'
    run carla-recap replay "$mcap" "$out/avoided.mcap" --duration 11 --then 15
    run carla-recap collisions "$out/avoided.mcap"
fi

say 'Convert a CARLA log to MCAP and back: the same bytes.'
run carla-recap convert samples/crossing.log "$out/crossing.mcap"
run carla-recap convert "$out/crossing.mcap" "$out/crossing.log"
run cmp samples/crossing.log "$out/crossing.log"

say 'Make the incident page, a page that compares both drives, and a file for Foxglove.'
run carla-recap report "$mcap" "$out/page.html"
if $simulates; then
    run carla-recap report "$mcap" "$out/compared.html" --compare "$out/avoided.mcap"
fi
run carla-recap export "$mcap" "$out/foxglove.mcap" --quiet

say 'Film the crash, from behind the hero.'
films=true
run carla-recap video "$mcap" "$out/crash.mp4" --start 9 --duration 9 --size 960x540 || films=false

hint() {
    printf '  %-50s %s\n' "$1" "${2:+# $2}"
}

say "Made in $PWD/$out. Open in a browser:"
hint "$out/page.html" 'the incident page'
if $simulates; then
    hint "$out/compared.html" 'the crash, and how it is avoided, side by side'
fi
if $films; then
    hint "$out/crash.mp4" 'the film'
else
    echo '  There is no film; the line above says why.'
fi
say 'To go on:'
hint '. .venv/bin/activate' 'the commands are here'
hint "carla-recap incidents $mcap" 'hard braking and long stops, too'
hint 'carla-recap info YOUR.log' 'a recording of yours'
say "Rerun's viewer, in 3D, takes 700 MB more:"
hint "pip install '.[rerun]'"
hint "carla-recap view $mcap" 'without a display, with --web'
say 'For Foxglove, the recording and its layout, which its menu "Layouts" imports:'
hint "$out/foxglove.mcap"
hint "$(python -c 'from carla_recap.show.foxglove import layout_files; print(layout_files()["Foxglove"])')"
