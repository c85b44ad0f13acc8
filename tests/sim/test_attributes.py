"""The attributes of blueprints: names, types, defaults and recommended values are CARLA 0.9.16's."""

from __future__ import annotations

import csv
from fnmatch import fnmatchcase
from pathlib import Path

from carla_recap.sim.attributes import ATTRIBUTE_TYPES, attribute_type, is_restricted
from carla_recap.sim.blueprints import Blueprint, standard_library

READERS = ({"true": True, "false": False}.__getitem__, int, float, str, lambda text: tuple(map(int, text.split(","))))
LIBRARY = standard_library()
with Path(__file__).with_name("attributes-0.9.16.csv").open(newline="", encoding="utf-8") as file:
    FACTS = list(csv.DictReader(file))
"""CARLA's attributes: name, type, C if constant, values (the default first if it can be chosen), and blueprints."""
KINDS = ("bool", "int", "float", "string", "color")


def test_defaults_and_choices_are_of_their_type() -> None:
    for blueprint in LIBRARY:
        for key, value in blueprint.attributes.items():
            for text in (value, *blueprint.choices.get(key, ())):
                READERS[attribute_type(key)](text)
                assert ATTRIBUTE_TYPES[attribute_type(key)].accepts(text), (blueprint.id, key)
        assert blueprint.choices.keys() <= blueprint.attributes.keys()
    limits = "-2147483648", "-2147483649", "2147483647", "2147483648"
    assert list(map(ATTRIBUTE_TYPES[KINDS.index("int")].accepts, limits)) == [True, False, True, False]


def having(fact: dict[str, str]) -> list[Blueprint]:
    patterns = fact["blueprints"].split()
    is_of_mesh = "static.prop.mesh" in patterns or "*" in patterns  # which is no prop with a size
    found = [blueprint for blueprint in LIBRARY if any(fnmatchcase(blueprint.id, pattern) for pattern in patterns)]
    return [blueprint for blueprint in found if blueprint.id != "static.prop.mesh" or is_of_mesh]


def test_attributes_are_those_of_carla() -> None:
    assert len(FACTS) == 203
    for fact in FACTS:
        key, values = fact["attribute"], fact["values"].split()
        blueprints = having(fact)
        assert blueprints, fact
        for blueprint in blueprints:
            assert KINDS[attribute_type(key)] == fact["type"]
            assert (key in blueprint.choices) is (fact["constant"] != "C"), (blueprint.id, key)
            if fact["constant"]:
                assert blueprint.attributes[key] in ("", *values), (blueprint.id, key)
            elif values:
                assert list(blueprint.choices[key]) == values, (blueprint.id, key)


def test_no_blueprint_has_another_attribute() -> None:
    expected: dict[str, set[str]] = {blueprint.id: set() for blueprint in LIBRARY}
    for fact in FACTS:
        for blueprint in having(fact):
            expected[blueprint.id].add(fact["attribute"])
    assert {blueprint.id: set(blueprint.attributes) for blueprint in LIBRARY} == expected


def test_some_attributes_are_restricted_to_their_recommended_values() -> None:
    keys = {key for blueprint in LIBRARY for key in blueprint.attributes if is_restricted(key)}
    assert keys == {"driver_id", "use_wheelchair", "exposure_mode", "scenario", "path_loss_model"}
