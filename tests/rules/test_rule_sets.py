from __future__ import annotations

import shutil
from textwrap import dedent

import pytest

from carla_recap import check, load_rules, open_recording
from carla_recap.errors import RecapError
from carla_recap.queries.measures import MEASURES, SHORT_NAMES
from carla_recap.rules.rule_sets import RulesError, parse_rules
from tests.rules.conftest import straight
from tests.samples import SAMPLES, carla_log, save, warnings_ignored
from tests.waiting import time_limit


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
        ("crossing.log", 'incidents = { kind = "hard braking", of = "hero", max = 0 }', "fail", "1 hard braking of the"),
        ("blocked.mcap", 'blocked = { max = "50 s" }', "fail", "1 stop of more than 50 s: vehicle.mercedes.sprinter (41)"),
        ("junction.mcap", 'duration = { min = "30 s" }', "fail", "the recording has 29.95 s instead of at least 30 s"),
        ("crash.mcap", 'incidents = { kind = ["hard-braking", "blocked"], max = 9 }', "pass", "2 hard braking or long"),
        ("junction.mcap", 'duration = { min = "1 min", max = "120 s" }', "fail", "29.95 s instead of at least 1 min and"),
        ("junction.mcap", "frames = { min = 1, max = 5 }", "fail", "600 frames instead of at least 1 and at most 5 frames"),
        ("junction.mcap", "frames = { min = 123456 }", "fail", "instead of at least 123456 frames"),
        ("junction.mcap", "duration = { min = 3600.125 }", "fail", "instead of at least 3600.125 s"),
        ("junction.mcap", 'actors = { of = "hero", min = 1, max = 1 }', "pass", "1 actor (the hero)"),
        ("junction.mcap", 'actors = { of = "role:ego", min = 1 }', "fail", "0 actors (the actor of the role ego)"),
        ("junction.mcap", 'map = "brickfield_Opt"', "pass", "the map is Brickfield"),
        ("junction.mcap", 'map = ["Town01", "Town02"]', "fail", "the map is Brickfield instead of Town01 or Town02"),
        ("crash.mcap", 'time_to_collision = { of = "hero", min = "1.5 s" }', "fail", "below 1.5 s: hero and walker.pedest"),
        (
            "crash.mcap",
            'speed = { of = "hero", max = "48 km/h" }',
            "fail",
            "the hero exceeds 48 km/h: hero, 49.97 km/h at",
        ),
        ("crash.mcap", 'deceleration = { of = "hero", max = "0.05 g" }', "fail", "exceeds 0.05 g: hero, 0.076 g at 9.85 s"),
        ("crash.mcap", 'speed = { of = "hero", max = 15 }', "pass", "the greatest speed of the hero is 13.88 m/s"),
        ("crash.mcap", 'distance_off_road = { of = "hero", max = "0.5 m" }', "pass", "no distance off road of the hero was"),
        (
            "crash.mcap",
            'jerk = { of = "role:ego", max = 15 }',
            "pass",
            "nothing to judge: no jerk of the actor of the role ego",
        ),
        ("junction.mcap", 'incidents = { kind = "red light", max = 0 }', "pass", "no red light runs"),
        (
            "crash.mcap",
            'incidents = { kind = ["red light", "stop sign"], max = 0 }',
            "pass",
            "no red light runs or stop sign",
        ),
    ],
)
def test_a_condition(sample, rule, status, message):
    found = verdict(sample, rule)
    assert (found.status, message in found.message) == (status, True), found.message


def test_rules_that_need_no_map_are_judged_without_it():
    text = '[rules.a]\nincidents = { kind = "red light", max = 0 }\n[rules.b]\nspeed_over_limit = { max = 5 }\n'
    text += "[rules.c]\ncollisions = { max = 9 }"
    with open_recording(SAMPLES / "crossing.log") as recording:
        verdicts = check(recording, parse_rules(text, "rules.toml"))
    assert [each.status for each in verdicts] == ["error", "error", "pass"]
    told = "the map 'Crossing' is unknown, but its roads are needed; --map or CARLA_RECAP_MAPS says where maps are"
    assert {each.message for each in verdicts[:2]} == {told}


@pytest.mark.parametrize(
    ("name", "status", "message"),
    [
        ("crash.mcap", "pass", "equal to {}/crash.mcap within 10 cm"),
        ("blocked.mcap", "fail", "differs from {}/blocked.mcap: "),
        ("junction.mcap", "error", "{}: has no baseline junction.log or .mcap"),
        ("crash?2.mcap", "error", "{}: has no baseline crash?2.log or .mcap"),
    ],
)
def test_a_recording_is_compared_with_its_baseline(tmp_path, name, status, message):
    (base := tmp_path / "base").mkdir()
    shutil.copy(SAMPLES / "crash.mcap", base)
    shutil.copy(SAMPLES / "junction.mcap", base / "blocked.mcap")
    rules = parse_rules('[rules.it]\nsame_as = { baseline = "base", tolerance = "10 cm" }', tmp_path / "rules.toml")
    with open_recording(shutil.copy(SAMPLES / name.replace("?2", ""), tmp_path / name)) as recording:
        (found,) = check(recording, rules)
    assert (found.status, found.message.startswith(message.format(base))) == (status, True)


@pytest.mark.parametrize(
    ("sample", "rule", "time", "actors", "details", "last"),
    [
        (
            "crash",
            'collisions = { of = "hero", max = 0 }',
            12.1,
            (41, 44),
            ["12.10 s: hero coll", "15.15 s: hero coll"],
            ": hero collides with walker.pedestrian.0004 (44) at 12.10 s",
        ),
        (
            "avoided",
            'incidents = { kind = "near-miss", max = 0 }',
            10.6,
            (41, 44),
            ["10.60 s: hero come"],
            "walker.pedestrian.0004 (44) at 11.00 s, at 50 km/h",  # which names one time
        ),
        ("crash", 'actors = { of = "hero", min = 2 }', None, (), [], " of at least 2"),  # nobody is to blame for too few
    ],
)
def test_a_failure_has_the_time_the_actors_and_all_offences(sample, rule, time, actors, details, last):
    found = verdict(f"{sample}.mcap", rule)
    assert (found.rule, found.status, found.time, found.actors) == ("it", "fail", pytest.approx(time), actors)
    assert found.message.endswith(last)
    assert [text[:18] for text in found.details] == details


def test_times_that_are_no_numbers_are_left_out():
    with warnings_ignored(), open_recording(carla_log("times.log")) as recording:
        (found,) = check(recording, parse_rules("[rules.it]\ncollisions = { max = 0 }", "rules.toml"))
    assert (found.status, found.time) == ("fail", None)
    assert found.message == "22 collisions instead of at most 0: v (13) collides with v (5)"


def test_a_rule_about_collisions_asks_a_web_server_once_and_baselines_can_be_there(web):
    text = '[rules.a]\ncollisions = { max = 9 }\n[rules.b]\nactors = { of = "hero", min = 1 }'
    with open_recording(f"{web.url}/crash.mcap") as recording:
        assert {each.status for each in check(recording, parse_rules(text, "rules.toml"))} == {"pass"}
    assert len(web.requests) == 1
    rules = parse_rules(f'[rules.a]\nsame_as = {{ baseline = "{web.url}/" }}', "rules.toml")
    with open_recording(SAMPLES / "crash.mcap") as recording:
        (found,) = check(recording, rules)
    assert (found.status, found.message) == ("pass", f"equal to {web.url}/crash.mcap within 0 m")


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
        ("[rule.a]", "unknown key 'rule'; did you mean rules? The keys are axes, places, rules"),
        ("[rules.a", "Expected ']'"),
        ("[rules.a]\nframes = { min = 1 }\n[rules.a]\nframes = { min = 1 }", "Cannot declare ('rules', 'a') twice"),
        ("[rules]\na = 1", "rule 'a': expected a table, as [rules.NAME], found 1"),
        ("[rules.a]\nframes = { min = 1 }\nmap = 'x'", "rule 'a': expected one condition, found frames and map"),
        ("[rules.a]\ndescription = 1\nmap = 'x'", "rule 'a': description: expected a text, found 1"),
        ("[rules.a]\ncollisions = 0", "rule 'a': collisions: expected a table of the keys of, with, at_fault, min, max,"),
        ("[rules.a]\ncollisions = {}", "rule 'a': collisions: expected min or max, found no bound"),
        ("[rules.a]\ncollisions = { maximum = 0 }", "rule 'a': collisions: unknown key 'maximum'; did you mean max?"),
        ("[rules.a]\ncollisions = { max = 0, of = 'heros' }", "collisions.of: expected hero, vehicle, walker, any,"),
        ("[rules.a]\nincidents = { max = 0 }", "incidents.kind: expected one or a list of collision, red-light, "),
        ("[rules.a]\nblocked = { of = 'hero' }", 'blocked.max: expected a number in s, or a text such as "1.5 s" with one'),
        (f"[rules.a]\nduration = {{ min = 1{'0' * 400} }}", "duration.min: "),
        ("[rules.a]\nmap = ''", "rule 'a': map: expected the name of a map or a list of names, found ''"),
        ("[rules.a]\njerk = { min = 3 }", "jerk: unknown key 'min'; the keys are of, max, during, after, until, where, "),
        ("[rules.a]\ntime_to_collision = { max = 1 }", "time_to_collision: unknown key 'max'; the keys are of, with, min, "),
        ("[rules.a]\npost_encroachment_time = { min = 1, for = 3 }", "unknown key 'for'; "),
        ("[rules.a]\nsame_as = { tolerance = 1 }", "same_as.baseline: expected the path of a recording, or of a folder "),
        ("[rules.a]\nsame_as = { baseline = 'http://a', tolerance = -1 }", "same_as.tolerance: expected a distance of 0"),
        ('[rules.""]\nmap = "x"', "rule '': expected a name"),
        ("a = " + "[" * 100_000, ""),
        ("a" + ".a" * 32_000 + " = 1", "line 1: expected keys of a few names, found "),
        ("[" + ".".join(["a"] * 30_000) + "] = 1", "line 1: expected keys of a few names, found "),
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
        [rules.f]
    """
    with pytest.raises(RulesError) as caught:
        parse_rules(dedent(text), "rules.toml")
    assert [fault.removeprefix("rules.toml: rule ")[:36] for fault in caught.value.faults] == [
        "'a': collisions.max: expected a whol",
        "'a': collisions: unknown key 'off'; ",
        "'b': unknown condition 'colisions'; ",
        "'c': duration.min: expected no more ",
        "'e': unknown condition 'foo'; the co",
        "'e': deceleration.max: expected a nu",
        "'e': deceleration: unknown key 'min'",
        "'f': expected one of the conditions ",
    ]
    assert str(caught.value).splitlines() == list(caught.value.faults)


def test_the_actor_beyond_the_number_is_the_offender():
    found, everyone = (verdict("crash.mcap", f'actors = {{ of = "vehicle", max = {most} }}') for most in (1, 0))
    assert found.status == "fail"
    assert found.details == everyone.details[1:]
    assert found.actors != everyone.actors


def test_thousands_of_faults_are_cut_short():
    with pytest.raises(RulesError) as caught, time_limit():
        parse_rules("[rules]\n" + "".join(f"a{index} = 1\n" for index in range(5000)), "rules.toml")
    assert len(caught.value.faults) == 101
    assert caught.value.faults[-1] == "rules.toml: and 4900 more faults"


# --- fault ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.0, 0.05, 5.0])
@pytest.mark.parametrize(
    ("rule", "fails"),
    [
        ('of = "hero"', True),
        ('of = "hero", at_fault = true', None),
        ('of = "hero", with = "walker", at_fault = true', None),
        ('of = "hero", with = "vehicle", at_fault = true', False),
        ('of = "walker", at_fault = true', True),
        ("at_fault = true", True),
        ("at_fault = false", True),
    ],
)
def test_an_actor_that_stands_has_not_caused_a_collision(judge, speed, rule, fails):
    """A walker at 2 m/s and the hero meet, which has a speed in m/s; None: if it is above 0.1 m/s."""
    ways = straight(speed, 0.6), straight(-2, 0.6, x=10)
    found = judge(f"collisions = {{ {rule}, max = 0 }}", *ways, hits={4: 2}, walkers=[1])
    assert found.status == ("fail" if (speed > 0.1 if fails is None else fails) else "pass")
    assert (" caused by " in found.message) == ("of =" in rule and "at_fault = true" in rule), found.message


def test_baselines_that_are_missing_are_faults_of_the_file(tmp_path):
    rules = [f"[rules.{n}]\nsame_as = {{ baseline = '{path}' }}" for n, path in enumerate(["absent", SAMPLES, "http://1/a"])]
    path = save(tmp_path / "rules.toml", "\n".join(rules).encode())
    with pytest.raises(RulesError) as caught:
        load_rules(path)
    (fault,) = caught.value.faults
    assert fault.startswith(f"{path}: rule '0': same_as.baseline: ")
    assert fault.endswith(f", found no {tmp_path / 'absent'}")


@pytest.mark.parametrize(("short", "name"), SHORT_NAMES.items())
def test_a_measure_has_a_short_name(short, name):
    bound = "min" if MEASURES[name].extreme == "least" else "max"
    rules = [parse_rules(f"[rules.close]\n{each} = {{ {bound} = 1 }}", "rules.toml").rules for each in (short, name)]
    assert rules[0] == rules[1]
