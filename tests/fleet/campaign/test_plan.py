from __future__ import annotations

import pytest

from carla_recap.errors import RecapError
from carla_recap.fleet.campaign.plan import (
    MOST,
    ParameterRange,
    check_keywords,
    file_name,
    parse_parameter,
    parse_seeds,
    planned,
)
from carla_recap.util.functions import Keywords


@pytest.mark.parametrize(
    ("text", "seeds"), [("7", [7]), ("1,5,9", [1, 5, 9]), ("1:4", [1, 2, 3, 4]), ("3,3", [3]), ("0:0", [0])]
)
def test_seeds_are_numbers_or_a_range(text, seeds):
    assert list(parse_seeds(text)) == seeds


@pytest.mark.parametrize("text", ["", "a", "1:", "5:1", "-1", "1:2:3", "1,,2", "1.5", "1" * 30, "1,2:3"])
def test_other_seeds_are_an_error(text):
    with pytest.raises(RecapError, match="seeds"):
        parse_seeds(text)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("speed=8,10", (8, 10)),
        ("speed=-1.5,2e3,.5", (-1.5, 2000.0, 0.5)),
        ("on=true,false", (True, False)),
        ("town=Town01,a b", ("Town01", "a b")),
        ('name=["a,b", 3, true]', ("a,b", 3, True)),
        ("delay=0.2..1.2", ParameterRange(0.2, 1.2)),
        ("count=1..5", ParameterRange(1, 5)),
        ("path=../a", ("../a",)),
    ],
)
def test_values_are_numbers_truth_values_or_texts(text, values):
    found = parse_parameter(text)[1]
    assert found == values
    if not isinstance(found, ParameterRange):
        assert list(map(type, found)) == list(map(type, values))


@pytest.mark.parametrize(
    "text",
    [
        "speed",
        "speed=",
        "=8",
        "a/b=1",
        f"{'x' * 101}=1",
        f"{'x' * 10_000}=1",
        "seed=1",
        "world=1",
        "checksum=1",
        "speed=8,,9",
        "speed=[",
        "speed=[]",
        "speed=[[1]]",
        "speed=[null]",
        "speed=2..1",
        "speed=a..b",
        "speed=1:3",
        "speed=0.5:1.5",
        "größe=1",
        f"speed={'9' * 200_000}",
    ],
)
def test_other_parameters_are_an_error_in_one_short_line(text):
    with pytest.raises(RecapError, match="parameter") as caught:
        parse_parameter(text)
    assert len(str(caught.value)) < 300
    assert "\n" not in str(caught.value)


def test_all_combinations_are_planned():
    runs = list(planned([1, 2], {"speed": (8, 10), "town": ("a",)}, "runs"))
    assert [run.location for run in runs] == [
        f"runs/seed={seed},speed={speed},town=a.mcap" for speed in (8, 10) for seed in (1, 2)
    ]
    assert runs[0].parameters == {"speed": 8, "town": "a"}
    assert runs[0].texts == {"seed": "1", "speed": "8", "town": "a"}


@pytest.mark.parametrize(
    ("seeds", "parameters", "message"),
    [
        ([], {}, "0 runs"),
        (range(10_000_000), {}, "10,000,000 runs"),
        ([1], {"a": range(MOST), "b": range(100)}, "10,000,000 runs"),
        ([1], {"a": ("1", 1)}, "twice"),
        ([-1], {}, "seed -1"),
        ([1], {"a": (float("nan"),)}, "finite"),
        ([1], {"a": ("x" * 10_001,)}, "10,000"),
    ],
)
def test_a_plan_that_is_wrong_is_an_error(seeds, parameters, message):
    with pytest.raises(RecapError, match=message):
        list(planned(seeds, parameters, "runs"))


@pytest.mark.parametrize(
    ("value", "escaped"),
    [("a/b", "a%2Fb"), ("../..", "..%2F.."), ("a,b=c", "a%2Cb%3Dc"), ("ü%\n", "%C3%BC%25%0A"), (True, "true"), ("", "")],
)
def test_values_are_escaped_in_names(value, escaped):
    assert file_name(7, {"text": value}) == f"seed=7,text={escaped}.mcap"


def test_long_names_are_cut_and_stay_different():
    one, two = (file_name(7, {"text": "x" * 9_000 + end}) for end in "ab")
    assert one != two
    assert len(one) < 200


def test_a_function_has_to_have_the_parameters():
    keywords = Keywords(("delay", "speed"), frozenset({"delay"}), has_any=False)
    check_keywords(keywords, ["delay"])
    with pytest.raises(RecapError, match=r"parameter spede: .* it has delay, speed"):
        check_keywords(keywords, ["delay", "spede"])
    with pytest.raises(RecapError, match="parameter delay: the function needs it"):
        check_keywords(keywords, ["speed"])
    check_keywords(Keywords((), frozenset(), has_any=True), ["anything"])
