"""YAML files of people, read strictly: what a loader would pass over in silence, or name badly, is refused here."""

import dataclasses
import types
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import yaml

LARGEST_FILE = 1_000_000  # bytes
DEEPEST = 20  # maps and lists within each other
LONGEST = 4096  # characters of a key or a value, as of a path; 1:2:3 is a number in YAML 1.1, read in quadratic time
# The parser in C, where PyYAML was built with it, takes a thirtieth of the time.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_WORDS = {int: "a whole number", float: "a number", str: "a word", bool: "true or false"}


def plain_yaml(path: Path, schema: type) -> str:
    """The text of the file `path`, which has keys and values of the dataclass `schema`.

    Raises ValueError, OSError, or one of yaml's errors for a file that is too large or says nothing, text that is not
    UTF-8, a key or value that is too long, a key given twice or unknown, an alias, a tag, and a value of another type.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST_FILE + 1)
    if len(content) > LARGEST_FILE:
        raise ValueError(f"it has more than {LARGEST_FILE} bytes")
    text = content.decode("utf-8-sig")
    _require_plain_tree(text)
    _require_fits(schema, yaml.load(text, _LOADER), "")
    return text


def _require_plain_tree(text: str) -> None:
    """Raises ValueError unless `text` is one map of maps, lists and scalars, each key of a map once."""
    open_maps: list[set[str] | None] = []  # the keys of each map that is open; None: a list
    at_key: list[bool] = []  # whether a key comes next in it
    documents = 0
    for event in yaml.parse(text, _LOADER):
        line = f"line {event.start_mark.line + 1}"
        if isinstance(event, yaml.DocumentStartEvent):
            documents += 1
        if not isinstance(event, yaml.NodeEvent | yaml.CollectionEndEvent):
            continue
        if documents > 1:
            raise ValueError(f"{line} begins a second document: give one")
        if isinstance(event, yaml.AliasEvent) or event.__dict__.get("tag") not in (None, "!"):
            raise ValueError(f"{line} has an alias or a tag: write out what it stands for")
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > LONGEST:
            raise ValueError(f"{line} has a key or value of {len(event.value)} characters: give at most {LONGEST}")
        if isinstance(event, yaml.CollectionEndEvent):
            open_maps.pop()
            at_key.pop()
            continue
        if not open_maps and not isinstance(event, yaml.MappingStartEvent):
            raise ValueError(f"{line} is no key with a value: write KEY: VALUE")
        keys = open_maps[-1] if open_maps else None
        if keys is not None and at_key[-1]:
            key = event.value if isinstance(event, yaml.ScalarEvent) else "[...]"
            if key in keys:
                raise ValueError(f"{line} gives the key '{key}' a second time: leave one out")
            keys.add(key)
        if at_key:
            at_key[-1] = not at_key[-1]
        if isinstance(event, yaml.CollectionStartEvent):
            open_maps.append(set() if isinstance(event, yaml.MappingStartEvent) else None)
            at_key.append(True)
            if len(open_maps) > DEEPEST:
                raise ValueError(f"{line} is more than {DEEPEST} levels deep")
    if not documents:
        raise ValueError("it says nothing: write KEY: VALUE, or leave the file out")


def _require_fits(hint: Any, value: Any, where: str) -> None:
    """Raises ValueError unless `value`, at the key `where`, has the type `hint`."""
    if get_origin(hint) in (Union, types.UnionType):
        if value is None:
            return
        [hint] = [part for part in get_args(hint) if part is not type(None)]
    told = f"{where or 'it'} is {value!s:.60}"
    if dataclasses.is_dataclass(hint):
        if not isinstance(value, dict):
            raise ValueError(f"{told}, where keys of its own belong")
        known = get_type_hints(hint)
        for key, inner in value.items():
            name = f"{where}.{key}".lstrip(".")
            if key not in known:
                raise ValueError(f"there is no key '{name:.60}': known are {', '.join(known)}")
            _require_fits(known[key], inner, name)
    elif get_origin(hint) is list:
        if not isinstance(value, list):
            raise ValueError(f"{told}, where a list belongs")
        for number, inner in enumerate(value):
            _require_fits(get_args(hint)[0], inner, f"{where}[{number}]")
    elif not _is_a(hint, value):
        raise ValueError(f"{told}, where {_WORDS.get(hint, hint)} belongs")


def _is_a(hint: type, value: Any) -> bool:
    if hint is float:
        if isinstance(value, str):  # 1e-3 is a word in YAML 1.1
            try:
                return float(value) is not None
            except ValueError:
                return False
        return isinstance(value, int | float) and not isinstance(value, bool)
    return type(value) is hint
