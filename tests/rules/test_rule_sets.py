from __future__ import annotations

import math
import shutil
import subprocess
import sys
from textwrap import dedent

import pytest

from carla_recap import ActorKind, Spawn, attributes, check, create_recording, load_rules, open_recording
from carla_recap.errors import RecapError
from carla_recap.queries.measures import MEASURES, SHORT_NAMES
from carla_recap.rules.rule_sets import RulesError, make_rules, parse_rules
from tests.samples import SAMPLES, carla_log, double, save, warnings_ignored
from tests.waiting import PATIENCE, time_limit


@pytest.fixture
def web():
    """A web server of the samples."""
    pytest.importorskip("obstore", reason="the extra `remote` is not installed")
    from tests.web import serve

    with serve(SAMPLES) as server:
        yield server


def verdict(sample: str, rule: str):
    rules = parse_rules(f"[rules.it]\n{dedent(rule)}", "rules.toml")
    with open_recording(SAMPLES / sample) as recording:
        (found,) = check(recording, rules)
    return found


# --- conditions ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sample", "rule", "status", "message"),
    [
        ("crash.mcap", 'collisions = { of = "hero", max = 0 }', "fail", "2 collisions of the hero instead of at most 0:"),
        ("junction.mcap", 'collisions = { of = "hero", max = 0 }', "pass", "no collisions of the hero"),
        ("crash.mcap", 'collisions = { of = "hero", with = "walker", max = 0 }', "fail", "with walkers instead of at most"),
        ("crash.mcap", 'collisions = { of = "vehicle.mercedes.*", min = 2 }', "fail", "1 collision of vehicle.mercedes"),
        ("junction.mcap", 'collisions = { of = "role:ego", max = 0 }', "pass", "nothing to judge: no collisions of the "),
        (
            "crossing.log",
            'incidents = { kind = "hard braking", of = "hero", max = 0 }',
            "fail",
            "1 hard braking of the hero instead of at most 0: hero brakes hard at 44 km/h at 23.50 s",
        ),
        ("blocked.mcap", 'blocked = { max = "50 s" }', "fail", "1 stop of more than 50 s: vehicle.mercedes.sprinter (41)"),
        ("junction.mcap", 'duration = { min = "30 s" }', "fail", "the recording has 29.95 s instead of at least 30 s"),
        (
            "crash.mcap",
            'incidents = { kind = ["hard-braking", "blocked"], max = 9 }',
            "pass",
            "2 hard braking or long stops",
        ),
        ("junction.mcap", 'duration = { min = "1 min", max = "120 s" }', "fail", "29.95 s instead of at least 1 min and"),
        ("junction.mcap", "frames = { min = 1, max = 5 }", "fail", "600 frames instead of at least 1 and at most 5 frames"),
        ("junction.mcap", "frames = { min = 123456 }", "fail", "instead of at least 123456 frames"),
        ("junction.mcap", "duration = { min = 3600.125 }", "fail", "instead of at least 3600.125 s"),
        ("junction.mcap", 'actors = { of = "hero", min = 1, max = 1 }', "pass", "1 actor (the hero)"),
        ("junction.mcap", 'actors = { of = "role:ego", min = 1 }', "fail", "0 actors (the actor of the role ego)"),
        ("junction.mcap", 'map = "brickfield_Opt"', "pass", "the map is Brickfield"),
        ("junction.mcap", 'map = ["Town01", "Town02"]', "fail", "the map is Brickfield instead of Town01 or Town02"),
    ],
)
def test_a_condition(sample, rule, status, message):
    found = verdict(sample, rule)
    assert (found.status, message in found.message) == (status, True), found.message


@pytest.mark.parametrize(
    ("rule", "status", "message"),
    [
        ('time_to_collision = { of = "hero", min = "1.5 s" }', "fail", "falls below 1.5 s: hero and walker.pedestrian.0004"),
        ('speed = { of = "hero", max = "48 km/h" }', "fail", "the speed of the hero exceeds 48 km/h: hero, 49.97 km/h at"),
        ('deceleration = { of = "hero", max = "0.05 g" }', "fail", "the hero exceeds 0.05 g: hero, 0.076 g at 9.85 s"),
        ('speed = { of = "hero", max = 15 }', "pass", "the greatest speed of the hero is 13.88 m/s"),
        ('distance_off_road = { of = "hero", max = "0.5 m" }', "pass", "no distance off road of the hero was measured"),
        ('jerk = { of = "role:ego", max = 15 }', "pass", "nothing to judge: no jerk of the actor of the role ego"),
    ],
)
def test_a_measure(rule, status, message):
    found = verdict("crash.mcap", rule)
    assert (found.status, message in found.message) == (status, True), found.message


@pytest.mark.parametrize(
    ("sample", "kind", "message"),
    [
        ("junction.mcap", '"red light"', "no red light runs"),
        ("crash.mcap", '["red light", "stop sign", "wrong way"]', "no red light runs, stop sign runs or drives "),
    ],
)
def test_an_incident_of_the_road(sample, kind, message):
    found = verdict(sample, f"incidents = {{ kind = {kind}, max = 0 }}")
    assert (found.status, found.message.startswith(message)) == ("pass", True)


def test_rules_that_need_no_map_are_judged_without_it():
    text = '[rules.a]\nincidents = { kind = "red light", max = 0 }\n[rules.b]\nspeed_over_limit = { max = 5 }\n'
    text += "[rules.c]\ncollisions = { max = 9 }"
    with open_recording(SAMPLES / "crossing.log") as recording:
        verdicts = check(recording, parse_rules(text, "rules.toml"))
    assert [each.status for each in verdicts] == ["error", "error", "pass"]
    told = "the map 'Crossing' is unknown, but its roads are needed; --map or CARLA_RECAP_MAPS says where maps are"
    assert {each.message for each in verdicts[:2]} == {told}


def test_a_recording_is_compared_with_its_baseline(tmp_path):
    (tmp_path / "base").mkdir()
    shutil.copy(SAMPLES / "crash.mcap", tmp_path / "base")
    shutil.copy(SAMPLES / "junction.mcap", tmp_path / "base" / "blocked.mcap")
    rules = parse_rules('[rules.it]\nsame_as = { baseline = "base", tolerance = "10 cm" }', tmp_path / "rules.toml")
    verdicts = {}
    for name in ("crash", "blocked", "junction"):
        with open_recording(SAMPLES / f"{name}.mcap") as recording:
            (verdicts[name],) = check(recording, rules)
    base = tmp_path / "base"
    assert (verdicts["crash"].status, verdicts["crash"].message) == ("pass", f"equal to {base / 'crash.mcap'} within 10 cm")
    assert (verdicts["blocked"].status, verdicts["blocked"].time) == ("fail", 0.0)
    assert verdicts["blocked"].message.startswith(f"differs from {base / 'blocked.mcap'}: ")
    assert (verdicts["junction"].status, verdicts["junction"].message) == (
        "error",
        f"{base}: has no baseline junction.log or .mcap",
    )
    with open_recording(shutil.copy(SAMPLES / "crash.mcap", tmp_path / "crash?2.mcap")) as recording:
        assert check(recording, rules)[0].message == f"{base}: has no baseline crash?2.log or .mcap"


def test_a_failure_has_the_time_the_actors_and_all_offences():
    found = verdict("crash.mcap", 'collisions = { of = "hero", max = 0 }')
    assert (found.rule, found.time, found.actors) == ("it", pytest.approx(12.1), (41, 44))
    assert found.details == (
        "12.10 s: hero collides with walker.pedestrian.0004 (44)",
        "15.15 s: hero collides with vehicle.mercedes.sprinter (42)",
    )


def test_a_rule_about_collisions_asks_a_web_server_once_and_baselines_can_be_there(web):
    text = '[rules.a]\ncollisions = { max = 9 }\n[rules.b]\nactors = { of = "hero", min = 1 }'
    with open_recording(f"{web.url}/crash.mcap") as recording:
        assert {each.status for each in check(recording, parse_rules(text, "rules.toml"))} == {"pass"}
    assert len(web.requests) == 1
    rules = parse_rules(f'[rules.a]\nsame_as = {{ baseline = "{web.url}/" }}', "rules.toml")
    with open_recording(SAMPLES / "crash.mcap") as recording:
        (found,) = check(recording, rules)
    assert (found.status, found.message) == ("pass", f"equal to {web.url}/crash.mcap within 0 m")


def test_times_that_are_no_numbers_are_left_out():
    with warnings_ignored(), open_recording(carla_log("times.log")) as recording:
        (found,) = check(recording, parse_rules("[rules.it]\ncollisions = { max = 0 }", "rules.toml"))
    assert (found.status, found.time) == ("fail", None)
    assert found.message == "22 collisions instead of at most 0: v (13) collides with v (5)"


def test_a_damaged_recording_gives_errors_and_the_rules_that_can_be_judged_are(tmp_path):
    content = bytearray((SAMPLES / "crash.mcap").read_bytes())
    content[len(content) // 3 : len(content) // 2] = bytes(len(content) // 2 - len(content) // 3)
    rules = parse_rules('[rules.map]\nmap = "Brickfield"\n[rules.speed]\nspeed = { max = 99 }', "rules.toml")
    with open_recording(save(tmp_path / "damaged.mcap", bytes(content))) as recording:
        verdicts = check(recording, rules)
    assert verdicts[0].status == "pass"
    assert verdicts[1].status == "error"
    assert verdicts[1].message.startswith("byte ")


# --- the file ------------------------------------------------------------------------------------------------------------


def test_the_description_is_the_authors_or_that_of_the_condition():
    rules = parse_rules(
        '[rules.a]\ndescription = "No  harm"\ncollisions = { max = 0 }\n[rules.b]\nblocked = { of = "hero", max = "2 min" }',
        "rules.toml",
    )
    assert [rule.description for rule in rules] == ["No harm", "standing still of the hero: at most 2 min"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected a table of the form [rules.NAME], found no rules"),
        ("[rules]", "expected a table of the form [rules.NAME], found no rules"),
        ("[rule.a]", "unknown key 'rule'; did you mean rules? The keys are axes, places, rules"),
        ("[rules.a", "Expected ']'"),
        ("[rules.a]\nframes = { min = 1 }\n[rules.a]\nframes = { min = 1 }", "Cannot declare ('rules', 'a') twice"),
        ("[rules]\na = 1", "rule 'a': expected a table, as [rules.NAME], found 1"),
        ("[rules.a]", "rule 'a': expected one of the conditions collisions, "),
        ("[rules.a]\ncolisions = { max = 0 }", "rule 'a': unknown condition 'colisions'; did you mean collisions?"),
        ("[rules.a]\nframes = { min = 1 }\nmap = 'x'", "rule 'a': expected one condition, found frames and map"),
        ("[rules.a]\ndescription = 1\nmap = 'x'", "rule 'a': description: expected a text, found 1"),
        ("[rules.a]\ncollisions = 0", "rule 'a': collisions: expected a table of the keys of, with, at_fault, min, max,"),
        ("[rules.a]\ncollisions = {}", "rule 'a': collisions: expected min or max, found no bound"),
        ("[rules.a]\ncollisions = { maximum = 0 }", "rule 'a': collisions: unknown key 'maximum'; did you mean max?"),
        ("[rules.a]\ncollisions = { max = -1 }", "collisions.max: expected a whole number of 0 or more, found -1"),
        ("[rules.a]\ncollisions = { max = 0, of = 'heros' }", "collisions.of: expected hero, vehicle, walker, any,"),
        ("[rules.a]\nincidents = { max = 0 }", "incidents.kind: expected one or a list of collision, red-light, "),
        ("[rules.a]\nblocked = { of = 'hero' }", 'blocked.max: expected a number in s, or a text such as "1.5 s" with one'),
        (f"[rules.a]\nduration = {{ min = 1{'0' * 400} }}", "duration.min: "),
        ("[rules.a]\nduration = { min = 5, max = 4 }", "duration.min: expected no more than max, found 5 s"),
        ("[rules.a]\nmap = ''", "rule 'a': map: expected the name of a map or a list of names, found ''"),
        ("[rules.a]\njerk = { min = 3 }", "jerk: unknown key 'min'; the keys are of, max, during, after, until, where, "),
        ("[rules.a]\ntime_to_collision = { max = 1 }", "time_to_collision: unknown key 'max'; the keys are of, with, min, "),
        ("[rules.a]\npost_encroachment_time = { min = 1, for = 3 }", "unknown key 'for'; "),
        ("[rules.a]\nspeed = { max = '3 m' }", 'speed.max: expected a number in m/s, or a text such as "1.5 m/s"'),
        ("[rules.a]\nsame_as = { tolerance = 1 }", "same_as.baseline: expected the path of a recording, or of a folder "),
        ("[rules.a]\nsame_as = { baseline = 'http://a', tolerance = -1 }", "same_as.tolerance: expected a distance of 0"),
        ('[rules.""]\nmap = "x"', "rule '': expected a name"),
        ("a = " + "[" * 100_000, ""),
        (f"[rules.short]\nframes = {{ max = {'9' * 5000} }}", ""),
        (f"[rules.short]\nframes = {{ max = 0x{'f' * 10_000} }}", ""),
    ],
)
def test_a_wrong_file_is_an_error_in_one_line_that_names_the_rule_and_what_was_expected(text, message):
    with pytest.raises(RecapError) as error, time_limit():
        parse_rules(text, "rules.toml")
    assert str(error.value).startswith("rules.toml: ")
    assert message in str(error.value)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 600


@pytest.mark.parametrize("last", [math.inf, math.nan])
def test_times_that_are_no_numbers_are_no_numbers_in_verdicts(tmp_path, last):
    with create_recording(tmp_path / "a.log", map_name="Town01") as recorder:
        for time in (0.0, 0.1, 0.2, 0.3, 0.4):
            spawned = [Spawn(id, ActorKind.VEHICLE, type_id="vehicle.audi.tt") for id in (7, 8) if not time]
            recorder.add_frame(time, spawned=spawned, transforms={"id": [7, 8], "x": [1000 * time, 900.0]})
    data = (tmp_path / "a.log").read_bytes()
    for time, damaged in ((0.2, math.inf), (0.3, math.inf), (0.4, last)):
        data = data.replace(double(time), double(damaged))
    save(tmp_path / "a.log", data)
    rules = make_rules(duration={"max": "9 s"}, post_encroachment_time={"min": 1})
    with open_recording(tmp_path / "a.log") as recording:
        length, crossing = check(recording, rules)
    assert (length.status, crossing.status) == ("fail", "pass")
    assert (
        length.message == f"the recording has {'inf s' if last == math.inf else 'an unknown length'} instead of at most 9 s"
    )


def test_a_file_that_cannot_be_read_is_an_error(tmp_path):
    for path, message in [
        (tmp_path / "absent.toml", "cannot be read: No such file"),
        (tmp_path, "cannot be read: Is a directory"),
        (save(tmp_path / "latin.toml", b"[rules.\xe4]"), "byte 7: expected UTF-8"),
        (save(tmp_path / "large.toml", b"# \n" * 4_000_000), "is larger than 64 kB"),
    ]:
        with pytest.raises(RecapError, match=message) as error:
            load_rules(path)
        assert str(error.value).startswith(str(path))


def test_all_faults_of_a_file_are_said():
    text = """
        [rules.a]
        collisions = { max = -1, off = "hero" }
        [rules.b]
        colisions = { max = 0 }
        [rules.c]
        duration = { min = "1 min", max = "10 s" }
        [rules.d]
        map = "Town01"
        [rules.e]
        deceleration = { min = 3, max = "2 parsecs" }
        foo = {}
        frames = { min = -1 }
        [rules.f]
    """
    with pytest.raises(RulesError) as caught:
        parse_rules(dedent(text), "rules.toml")
    assert [fault.removeprefix("rules.toml: ")[:42] for fault in caught.value.faults] == [
        "rule 'a': collisions.max: expected a whole",
        "rule 'a': collisions: unknown key 'off'; d",
        "rule 'b': unknown condition 'colisions'; d",
        "rule 'c': duration.min: expected no more t",
        "rule 'e': unknown condition 'foo'; the con",
        "rule 'e': deceleration.max: expected a num",
        "rule 'e': deceleration: unknown key 'min';",
        "rule 'e': frames.min: expected a whole num",
        "rule 'f': expected one of the conditions c",
    ]
    assert str(caught.value).splitlines() == list(caught.value.faults)


def test_the_actor_beyond_the_number_is_the_offender():
    found = verdict("crash.mcap", 'actors = { of = "vehicle", max = 1 }')
    everyone = verdict("crash.mcap", 'actors = { of = "vehicle", max = 0 }')
    assert found.status == "fail"
    assert found.details == everyone.details[1:]
    assert found.actors != everyone.actors


def test_no_actor_is_to_blame_if_there_are_too_few():
    found = verdict("crash.mcap", 'actors = { of = "hero", min = 2 }')
    assert (found.message, found.time) == ("1 actor (the hero) instead of at least 2", None)


def test_the_message_of_a_near_miss_names_one_time():
    found = verdict("avoided.mcap", 'incidents = { kind = "near-miss", max = 0 }')
    text = "hero comes within 1.1 s of walker.pedestrian.0004 (44) at 11.00 s, at 50 km/h"
    assert found.message == f"1 near miss instead of at most 0: {text}"
    assert found.details == (f"10.60 s: {text}",)


def test_thousands_of_faults_are_cut_short():
    with pytest.raises(RulesError) as caught, time_limit():
        parse_rules("[rules]\n" + "".join(f"a{index} = 1\n" for index in range(5000)), "rules.toml")
    assert len(caught.value.faults) == 101
    assert caught.value.faults[-1] == "rules.toml: and 4900 more faults"


@pytest.mark.parametrize("key", ["a" + ".a" * 32_000, "[" + ".".join(["a"] * 30_000) + "]"])
def test_a_key_of_thousands_of_names_costs_nothing(tmp_path, key):
    rules = save(tmp_path / "rules.toml", f"{key} = 1\n".encode())
    script = f"""if True:
        import resource
        from carla_recap import load_rules
        from carla_recap.errors import RecapError
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        try:
            load_rules({str(rules)!r})
        except RecapError as error:
            print(error)
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    """
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=PATIENCE, check=True)
    message, kilobytes = done.stdout.splitlines()
    assert message.startswith(f"{rules}: line 1: expected keys of a few names, found ")
    assert int(kilobytes) < 50_000


# --- fault ---------------------------------------------------------------------------------------------------------------


@pytest.fixture(params=[0.0, 0.05, 5.0])
def struck(request, tmp_path):
    """A recording in which a walker and the hero meet, and the speed of the hero, in m/s; the walker walks at 2 m/s."""
    hero = Spawn(1, ActorKind.VEHICLE, type_id="vehicle.tesla.model3", attributes=attributes(role_name="hero"))
    walker = Spawn(2, ActorKind.WALKER, type_id="walker.pedestrian.0001")
    with create_recording(tmp_path / "run.log", map_name="Town01") as recorder:
        for frame in range(6):
            x = [100 * request.param * frame * 0.1, 1000 - 200 * frame * 0.1]
            hits = {"id": [0], "actor1": [1], "actor2": [2], "hero1": [True], "hero2": [False]} if frame == 4 else None
            more = {"collisions": hits} if hits else {}
            recorder.add_frame(
                frame * 0.1, spawned=[hero, walker] if frame == 0 else [], transforms={"id": [1, 2], "x": x}, **more
            )
    with open_recording(tmp_path / "run.log") as recording:
        yield recording, request.param


def test_an_actor_that_stands_has_not_caused_a_collision(struck):
    recording, speed = struck
    caused = speed > 0.1
    for rule, passes in [
        ('{ of = "hero", max = 0 }', False),
        ('{ of = "hero", max = 0, at_fault = true }', not caused),
        ('{ of = "hero", with = "walker", max = 0, at_fault = true }', not caused),
        ('{ of = "hero", with = "vehicle", max = 0, at_fault = true }', True),
        ('{ of = "walker", max = 0, at_fault = true }', False),
        ("{ max = 0, at_fault = true }", False),
        ("{ max = 0, at_fault = false }", False),
    ]:
        (found,) = check(recording, parse_rules(f"[rules.it]\ncollisions = {rule}", "rules.toml"))
        assert (rule, found.status) == (rule, "pass" if passes else "fail")
    (found,) = check(recording, make_rules(collisions={"of": "hero", "max": 0, "at_fault": True}))
    expected = "1 collision caused by the hero instead of at most 0: " if caused else "no collisions caused by the hero"
    assert found.message.startswith(expected)


def test_baselines_that_are_missing_are_faults_of_the_file(tmp_path):
    path = tmp_path / "rules.toml"
    path.write_text(
        f"[rules.a]\nsame_as = {{ baseline = 'absent' }}\n[rules.b]\nsame_as = {{ baseline = '{SAMPLES}' }}\n"
        "[rules.c]\nsame_as = { baseline = 'http://127.0.0.1:1/a.mcap' }\n"
    )
    with pytest.raises(RulesError) as caught:
        load_rules(path)
    found = f"found no {tmp_path / 'absent'}"
    expected = f"expected the path of a recording, or of a folder of recordings, {found}"
    assert caught.value.faults == (f"{path}: rule 'a': same_as.baseline: {expected}",)


@pytest.mark.parametrize(("short", "name"), SHORT_NAMES.items())
def test_a_measure_has_a_short_name(short, name):
    bound = "min" if MEASURES[name].extreme == "least" else "max"
    rules = [parse_rules(f"[rules.close]\n{each} = {{ {bound} = 1 }}", "rules.toml").rules for each in (short, name)]
    assert rules[0] == rules[1]
