"""Registries: names, entry points, and classes of other packages."""

import hashlib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from models import registry as registry_module
from models.errors import InputError
from models.registry import Registry


class Ours:
    name = "ours"


class Theirs:
    name = "theirs"


class Nameless:
    pass


class Slashed:
    name = "a/b"


HERE = __name__


@pytest.fixture
def registry(monkeypatch):
    points = [
        EntryPoint("theirs", f"{HERE}:Theirs", "hindsight.things"),
        EntryPoint("alias", f"{HERE}:Theirs", "hindsight.things"),
    ]
    monkeypatch.setattr(registry_module, "entry_points", lambda group: [p for p in points if p.group == group])
    return Registry("thing", {"ours": f"{HERE}:Ours", "broken": "no_such_module:Class"})


def test_names_need_no_import(registry):
    assert list(registry) == ["ours", "broken", "theirs", "alias"]
    assert registry.label("broken") == "broken"
    registry.check("broken")


def test_ours_are_not_looked_for_among_what_is_installed(registry, monkeypatch):
    monkeypatch.setattr(registry_module, "entry_points", lambda group: pytest.fail("read from the disk"))
    assert registry.label("ours") == "ours"
    registry.check("ours")


def test_by_name_by_entry_point_and_by_class(registry):
    assert registry["ours"].name == "ours"
    assert registry["theirs"].name == "theirs"
    assert registry[f"{HERE}:Theirs"].name == registry.label(f"{HERE}:Theirs") == "theirs"


@pytest.mark.parametrize(
    ("spec", "named"),
    [
        ("other", "no thing 'other': choose from ours, broken, theirs, alias, or give one as package.module:Class"),
        ("broken", "cannot be loaded"),
        ("alias", "calls itself 'theirs'"),
        (f"{HERE}:Missing", "cannot be loaded"),
        (f"{HERE}:Nameless", "has no attribute `name`"),
        (":", "cannot be loaded"),
        (f"{HERE}:Slashed", "has the name 'a/b': files have it, give it letters"),
    ],
)
def test_what_is_not_there_is_named(registry, spec, named):
    with pytest.raises(InputError, match=named):
        registry[spec]


def test_code_is_that_of_the_file_of_another_package(registry):
    assert registry.code("ours") == ""
    expected = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:16]
    assert registry.code("theirs") == registry.code(f"{HERE}:Theirs") == expected


def of_family(rest):
    if rest == "none":
        raise InputError("there is no such one")
    return type("Made", (), {"name": f"made-{rest}"})


def test_a_family_makes_what_stands_behind_its_prefix(registry):
    families = Registry("thing", {"ours": f"{HERE}:Ours"}, families={"made": f"{HERE}:of_family"})
    assert families["made:Up"].name == families.label("made:Up") == "made-Up"
    assert next(iter(families)) == "ours"
    assert families[f"{HERE}:Theirs"].name == "theirs"
    with pytest.raises(InputError, match="there is no such one"):
        families.check("made:none")
