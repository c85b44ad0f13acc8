"""Wrong arguments: an error is a line that says what to do, and nothing is written."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import pytest

from tests.cli.command import error
from tests.fleet.campaign import functions
from tests.samples import SAMPLES, names_in

EVIL = "\x1b]0;evil\x07\x1b[31m\x9b2J"
RIG = [{"type": "sensor.other.imu", "id": "imu"}]
BAD_RIG = [{"type": "sensor.lidar.ray_cast", "id": "lidar", "x": 0, "y": 0, "z": 2, "channels": 0}]
CAMPAIGN = "campaign --out runs functions.py:drive"
ONE_OF = "One of --route and --from-drive was expected."
NO_TIME = "seconds were expected, such as #t=12.1, or #t=12.1,20"
SIM = dict.fromkeys(("record", "replay", "campaign"), "pymunk")
NEEDED = {**SIM, "sense": "embreex", "export": "rerun", "snapshot": "moderngl"}
"""The packages of extras that commands need."""
CASES = [
    # which command, and the forms of answers
    ("nonsense", "No such command 'nonsense'"),
    ("colisions", "No such command 'colisions'. Did you mean 'collisions'? Try 'carla-recap --help'."),
    (f"--'{EVIL}'", "No such option"),
    (f"'{EVIL}\n'", "No such command"),
    ("info", "Missing argument 'SOURCE...'"),
    ("info a.log --jso", "(Did you mean one of: '--jobs', '--json'?)"),
    ("info a.log --compat --json", "--compat is about CARLA's text: it does not go with --json"),
    ("actors a.log --compat", "No such option '--compat'"),
    ("collisions a.log --json --text", "--json and --text: one of them was expected. "),
    ("sql index 'select 1' --json --csv", "--json and --csv: one of them was expected. "),
    # queries
    (f"collisions a.log --types '{EVIL[:2]}'", "is no type of a collision's actor"),
    ("collisions a.log --types vwx", "such as hv"),
    ("blocked a.log --min-time nan", "'nan' is not a number"),
    ("blocked a.log --min-time -1", "'--min-time': '-1'"),
    ("blocked a.log --min-distance -1", "'-1' is not a number of 0 or more"),
    ("incidents a.log --time-to-collision 61", "--time-to-collision"),
    ("incidents a.log --post-encroachment-time 61", "--post-encroachment-time"),
    ("diff b.mcap b.mcap --tolerance -1", "'-1' is not a number of 0 or more"),
    # scores
    ("score b.mcap", ONE_OF),
    ("score b.mcap --from-drive --route routes.xml", ONE_OF),
    ("score b.mcap --from-drive --route-id 1", "--route-id goes with --route."),
    ("score b.mcap --from-drive --min-completion 1", "--min-completion goes with --route."),
    ("score b.mcap --from-drive --junit out.xml", "--junit goes with a limit, such as --min-score."),
    ("score b.mcap --from-drive --min-score nan", "'nan' is not a number of 0 to 100."),
    ("score b.mcap --from-drive --min-completion 101", "'101' is not a number of 0 to 100."),
    ("score b.mcap --from-drive --max red_light", "'red_light' is no limit; KIND=N was expected, such as red_light=0"),
    ("score b.mcap --from-drive --max speeding=0", "'speeding=0' is no limit"),
    ("score b.mcap --from-drive --actor 99999", "b.mcap: no vehicle 99999; known ids are 41 (hero)"),
    ("score b.mcap --route none.xml", "none.xml: No such file or directory"),
    ("score b.mcap --route routes.xml --route-id 9", "routes.xml: there is no route '9'; it has 1, 2"),
    # rules: what cannot be written is found before anything is read
    ("check none.mcap --rules rules.toml --junit rig.json/out.xml", "rig.json: is a file; a folder"),
    ("check none.mcap --rules rules.toml --junit .", "cannot be written: "),
    ("check none.mcap --rules rules.toml --junit rig.json", "is no XML"),
    ("check none.mcap --rules rules.toml --html rig.json/out", "rig.json: is a file"),
    ("check none.mcap --rules rules.toml --html rig.json", "rig.json: is a file; a folder was expected"),
    # files that are written
    ("convert a.log", "Missing argument"),
    ("convert a.log ''", "a path or a URL was expected"),
    ("convert ftp://a/b.mcap out.log", "unknown kind of URL; s3, gs, az, abfs, http, https or file was expected"),
    ("clip b.mcap out.log --start 99", "nothing at 99 s; the recording ends at 59.95 s"),
    ("clip a.log#t=20,10 out.log", "a.log#t=20,10: an end after 20 s was expected"),
    ("clip a.log#t=56 out.log", "a.log: nothing at 56 s; the recording ends at 53 s"),  # 5 s before is in it
    ("clip a.log#t=99 out.log", "a.log: nothing at 99 s; the recording ends at 53 s"),
    ("clip a.log#t=abc out.log", f"a.log#t=abc: 'abc' is no time; {NO_TIME}"),
    ("clip a.log#t= out.log", f"a.log#t=: '' is no time; {NO_TIME}"),
    ("snapshot a.log#t=1,x out.png", f"a.log#t=1,x: '1,x' is no time; {NO_TIME}"),
    ("clips a.log s3://bucket/out", "s3://bucket/out: is a URL; a path was expected, since only files of this machine"),
    ("import a.csv out.log --column east", "no NAME=COLUMN"),
    ("import a.csv out.log --date soon", "'soon' is no date"),
    ("import a.csv out.log --date 0001-01-01T00:00:00+14:00", "'0001-01-01T00:00:00+14:00' is no date"),
    # exports
    ("export b.mcap out.foo", "'out.foo' does not end in .rrd, .mcap, .csv or .xosc; --to names what is a folder: parquet"),
    ("export a.log b.mcap out", "--to says what"),
    ("export a.log out.rrd --follow somebody", "'somebody' is neither an actor id nor hero"),
    ("export a.log out.mcap --to rerun", "'out.mcap' does not end in .rrd"),
    ("export a.log out.csv --follow hero", "--follow does not go with --to csv"),
    ("export a.log out.xosc --view top", "--view does not go with --to xosc"),
    ("export a.log out --to parquet --start 0", "--start does not go with --to parquet"),
    ("export a.log out --to parquet --split train=1", "--split does not go with --to parquet."),
    ("export a.log out.mcap --cameras cameras", "--cameras"),
    ("export a.log out.rrd --map broken.xodr", "broken.xodr: "),
    ("export a.log out.rrd --map .", "a.log: no .xodr in . for the map 'Crossing'"),
    ("export a.log out --to kitti", "--to kitti needs --rig RIG.json."),
    ("export a.log out --to coco --rig rig.json --camera x", "--camera does not go with --to coco."),
    ("export a.log out --to coco --rig rig.json --split train", "are no shares; some such as train=0.8,val=0.2"),
    ("export a.log out --to coco --rig rig.json --newer", "--newer does not go with --to coco"),
    # pictures, pages, sensors
    ("snapshot . out.png --at 3", ".: is a folder; a recording was expected, a .log or .mcap file"),
    ("snapshot a.log out.png", "Missing option '--at'. SRC#t=S says it, too."),
    ("snapshot a.log out.png --at -53.1", "nothing 53.1 s before the end; the recording has 53 s"),
    ("snapshot a.log out.png --at 99", "nothing at 99 s"),
    ("snapshot a.log out.png --at 1 --size 12", "'12' is no size"),
    ("snapshot b.mcap out.png --at 3 --follow 99", "no actor 99 to follow; known ids are 41 (hero), 47 (vehicle)"),
    ("report a.log b.mcap page.html", "names a file"),
    ("report a.log page.html --serve", "--serve goes with a folder"),
    ("report a.log page --serve --json", "--serve prints its address"),
    ("report a.log page.html --viewer", "--viewer goes with a folder"),
    ("report a.log page --compare a.log --viewer", "--viewer goes with one recording"),
    ("report a.log b.mcap page --compare b.mcap", "goes with one recording"),
    ("sense a.log out.mcap --rig bad.json", "bad.json: sensor 'lidar': channels: 0; "),
    ("sense a.log out.mcap --rig none.json", "none.json: cannot be read"),
    ("sense a.log out.mcap --rig rig.json --actor 99", "no actor 99 to carry the rig"),
    # the simulator
    ("record a.mcap --town Atlantis", "town 'Atlantis': expected Brickfield"),
    ("record a.txt --duration 2", "unknown format"),
    ("record a.mcap --vehicles 1000 --walkers 0", "has room for"),
    ("record a.mcap --seed -1", "'--seed': -1"),
    ("record a.mcap --duration 0", "is not a number of more than 0"),
    ("record a.mcap --town ''", "found an empty text"),
    ("record a.mcap --crash --blocked", "--crash and --blocked"),
    ("record a.mcap --town broken.xodr", "broken.xodr: "),
    ("record a.log --town Atlantis", "exists already"),  # the destination is looked at first
    ("record bare --force --town Atlantis", "bare: no suffix, which says the format; .log or .mcap was expected"),
    ("record /dev/null --force --town Atlantis", "/dev/null: no suffix, which says the format"),
    ("record folder.log --force --town Atlantis", "cannot be written: is a directory"),
    ("record rig.json/a.mcap --town Atlantis", "is a file; a folder was expected"),
    ("replay a.log bare --force --town Atlantis", "bare: no suffix, which says the format"),
    ("replay none.log out.mcap", "none.log"),
    ("replay b.mcap a.txt", "unknown format"),
    ("replay b.mcap a.log", "exists already"),
    ("campaign --out runs", "either FILE.py:FUNCTION or --serve"),
    ("campaign --out runs gone.py:run", "gone.py: "),
    ("campaign --out runs functions.py:gone", "has no function gone; it has drive, wait_here, misbehave"),
    (
        "campaign --out runs functions.py:misbehave",
        "parameter how: the function needs it; --param how=VALUE,... was expected",
    ),
    (f"{CAMPAIGN} --param vehicles=1 --param vehicles=2", "parameter vehicles: is given twice"),
    (f"{CAMPAIGN} --param vehicles=1..3", "a range goes with --search"),
    (f"{CAMPAIGN} --measure beauty", "'beauty': is no measure of a run; one of collisions, "),
    (f"{CAMPAIGN} --search", "--search needs either --minimize or --maximize"),
    (f"{CAMPAIGN} --minimize ttc", "go with --search"),
    (f"{CAMPAIGN} --search --minimize ttc", "a parameter with a range or several values was expected"),
    (f"{CAMPAIGN} --rules gone.toml", "gone.toml"),
    (f"{CAMPAIGN} --town Nowhere", "Nowhere"),
    (f"{CAMPAIGN} --measure score", "a score needs --route or --from-drive"),
    (f"{CAMPAIGN} --route-id 1", "--route-id goes with --route"),
    (f"{CAMPAIGN} --route gone.xml", "gone.xml"),
    ("campaign --out runs --serve gone.py", "gone.py: is no file"),
    (f"{CAMPAIGN} --python {sys.executable}", "--python goes with --serve"),
    (f"{CAMPAIGN} --report functions.py", "is a file; a folder was expected"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two recordings, and what else the arguments name."""
    folder = tmp_path_factory.mktemp("errors")
    for name, sample in (("a.log", "crossing.log"), ("b.mcap", "crash.mcap"), ("routes.xml",) * 2, ("rules.toml",) * 2):
        (folder / name).symlink_to(SAMPLES / sample)
    (folder / "functions.py").symlink_to(functions.__file__)
    (folder / "rig.json").write_text(json.dumps(RIG))
    (folder / "bad.json").write_text(json.dumps(BAD_RIG))
    (folder / "broken.xodr").write_text("<OpenDRIVE/>")
    (folder / "a.csv").write_text("t,id,x,y\n0,7,1,2\n")
    (folder / "folder.log").mkdir()
    return folder


@pytest.mark.parametrize(("arguments", "message"), CASES, ids=range(len(CASES)))
def test_an_error_is_a_line_that_says_what_to_do(folder: Path, arguments: str, message: str) -> None:
    words, before = shlex.split(arguments), names_in(folder)
    if words[0] in NEEDED:
        pytest.importorskip(NEEDED[words[0]], reason="an extra is not installed")
    said = error(*words, cwd=folder)
    assert message in said
    assert len(said) < 600
    assert names_in(folder) == before
