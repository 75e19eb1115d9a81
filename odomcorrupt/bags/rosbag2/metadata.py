"""metadata.yaml: reading, editing, and creation where there was none."""

from __future__ import annotations

from collections import Counter
from contextlib import suppress
from copy import deepcopy
from functools import lru_cache
from io import StringIO
from typing import TYPE_CHECKING, Any, NamedTuple

from odomcorrupt.bags.rosbag2.bounded_yaml import load_yaml, read_text, yaml_of, yaml_problem
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from odomcorrupt.bags.block import Definition, PartContents

_ROOT = "rosbag2_bagfile_information"
_NEW: dict[str, Any] = {
    "storage_identifier": "",
    "duration": {},
    "starting_time": {},
    "message_count": 0,
    "topics_with_message_count": [],
    "compression_format": "",
    "compression_mode": "",
    "relative_file_paths": [],
    "files": [],
    "custom_data": {},
    "ros_distro": "",
}
"""What a metadata.yaml of version 8 holds, in its order."""
_FIRST_WITH_PLAIN_NAMES, _FIRST_WITH_FILES = 4, 5
"""Versions of metadata.yaml since which names of files have no directory, and the contents of each file are listed."""
_WITHOUT = "--recover does without it, as if it were removed: the directory's files are read by their names"


class TopicInfo(NamedTuple):
    """A topic of metadata.yaml."""

    name: str
    encoding: str
    definition: Definition


def read_info(path: Path) -> dict[str, Any]:
    """Return the bag information of a metadata.yaml."""
    try:
        document = _parsed(read_text(path))
    except ValueError as error:
        raise BagError(f"{path}: cannot be read: {error}; {_WITHOUT}") from error
    info = document.get(_ROOT) if isinstance(document, dict) else None
    if not isinstance(info, dict) or not isinstance(info.get("relative_file_paths"), list):
        raise BagError(f"{path}: is not a rosbag2 metadata.yaml, or the beginning of one; {_WITHOUT}")
    return info


def differences(info: Mapping[str, Any], storage: str, number: int, topics: Iterable[tuple[str, str]]) -> list[str]:
    """Return what bag information states and the files do not hold, one sentence each.

    storage, number, topics : of the files: mcap or sqlite3, of their messages, names and types
    """
    try:
        known = {tuple(map(one["topic_metadata"].get, ("name", "type"))) for one in info["topics_with_message_count"]}
    except (AttributeError, KeyError, TypeError):
        known = set()
    count, stated = info.get("message_count"), info.get("storage_identifier")
    lacking = ", ".join(f"{topic} ({msgtype})" for topic, msgtype in topics if (topic, msgtype) not in known)
    said = {
        f"states {count} messages, the files hold {number}": isinstance(count, int) and count != number,
        f"states the storage {stated!r}, the files are {storage}": stated != storage,
        f"does not list {lacking}": lacking,
    }
    return [f"metadata.yaml {one}: an output states what is there" for one, wrong in said.items() if wrong]


def edited(text: str, change: Callable[[dict[str, Any]], None]) -> str:
    """Return a YAML text with its bag information changed, all else unchanged; the text itself if nothing changes."""
    out = StringIO()
    try:
        document = deepcopy(_parsed(text))
        change(document.get(_ROOT, document))
        if document == _parsed(text):
            return text
        yaml_of("rt").dump(document, out)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise BagError(f"metadata: not as rosbag2 writes it ({yaml_problem(error)}); remove metadata.yaml") from error
    return out.getvalue()


def add_provenance(info: dict[str, Any], name: str, items: Mapping[str, str]) -> None:
    """Add provenance metadata to custom_data."""
    custom: Any = info.get("custom_data") if isinstance(info.get("custom_data"), dict) else {}
    info["custom_data"] = {**custom, **{f"{name}.{key}": value for key, value in items.items()}}


def count(
    info: dict[str, Any], storage: str, parts: Sequence[PartContents], topics: Sequence[TopicInfo], mode: str = "none",
    folder: str = "",
) -> None:  # fmt: skip
    """State the contents of a bag's files as they were counted, whatever was stated before.

    info : the bag information, which is changed
    storage, mode : mcap or sqlite3; what is compressed
    parts : the files, with their names
    topics : all topics; those that the information lacks are added
    folder : name of the bag's directory, which old versions put before the files' names
    """
    if not isinstance(info.get("version"), int):
        described = [_topic_entry(topic, hashed=True)["topic_metadata"] for topic in topics]
        named = any(isinstance(one["offered_qos_profiles"], list) for one in described)
        kept = {key: info.get(key) or deepcopy(value) for key, value in _NEW.items()}
        info.update({"version": 9 if named else 8, **kept})
    _count_topics(info, parts, topics)
    info["storage_identifier"] = storage
    _span(info, [part for part in parts if part.counts])
    if mode != "none" or str(info.get("compression_mode") or "none").lower() not in ("none", "storage"):
        info["compression_mode"] = "" if mode == "none" else mode.upper()
        info["compression_format"] = "" if mode == "none" else "zstd"
    before = f"{folder}/" if folder and info["version"] < _FIRST_WITH_PLAIN_NAMES else ""
    # a player would open what other names point to: the input
    info["relative_file_paths"] = [before + part.name for part in parts]
    if info.get("files") or info["version"] >= _FIRST_WITH_FILES:
        stated = {str(file.get("path")): file for file in info.get("files") or []}
        info["files"] = [stated.get(part.name, {"path": part.name}) for part in parts]
        for file, part in zip(info["files"], parts, strict=True):
            _span(file, [part])


def _count_topics(info: dict[str, Any], parts: Sequence[PartContents], topics: Sequence[TopicInfo]) -> None:
    """State the number of messages of each topic; topics that the information lacks are added."""
    counts = Counter[str]()
    for part in parts:
        counts.update(part.counts)
    entries: Any = info.get("topics_with_message_count")
    try:
        sound = isinstance(entries, list) and all(isinstance(one["topic_metadata"]["name"], str) for one in entries)
    except (KeyError, TypeError):
        sound = False
    if not sound:
        entries = info["topics_with_message_count"] = []
    known = {entry["topic_metadata"]["name"] for entry in entries}
    hashed = not entries or any("type_description_hash" in entry["topic_metadata"] for entry in entries)
    for topic in topics:
        if topic.name not in known:
            known.add(topic.name)
            entries.append(_topic_entry(topic, hashed=hashed))
    types = [(topic.name, topic.definition.name) for topic in topics]
    first, pairs = dict(reversed(types)), set(types)
    for entry in entries:
        stated = entry["topic_metadata"]
        if stated["name"] in first and (stated["name"], stated.get("type")) not in pairs:
            stated["type"] = first[stated["name"]]
        # of a name with two types one entry has the count
        entry["message_count"] = counts.pop(stated["name"], 0)


def _span(info: dict[str, Any], parts: Sequence[PartContents]) -> None:
    """State time span and number of messages of files, in the maps that are there."""
    start_ns = min((part.start_ns for part in parts), default=0)
    end_ns = max((part.end_ns for part in parts), default=0)
    for key, inner, value in (
        ("starting_time", "nanoseconds_since_epoch", start_ns),
        ("duration", "nanoseconds", end_ns - start_ns),
    ):
        if info.get(key) != {inner: value}:
            info[key] = {inner: value}
    info["message_count"] = sum(sum(part.counts.values()) for part in parts)


def generated(
    storage: str, parts: list[PartContents], topics: list[TopicInfo], mode: str = "none", *, root: bool = True
) -> str:
    """Return a new metadata.yaml for a bag that had none.

    storage, parts, topics, mode : as of `count`
    root : whether the information is under its key, as in the file; the metadata table of sqlite3 has it bare
    """
    info: dict[str, Any] = {}
    count(info, storage, parts, topics, mode)
    yaml = yaml_of("safe")
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False
    out = StringIO()
    yaml.dump({_ROOT: info} if root else info, out)
    return out.getvalue()


def _topic_entry(topic: TopicInfo, *, hashed: bool) -> dict[str, Any]:
    """Return the entry of a topic; since version 9 QoS uses names for numbers, and is not a string."""
    metadata = topic.definition.metadata
    qos: Any = metadata.get("offered_qos_profiles", "")
    if "history: keep" in qos or "history: system" in qos or "history: unknown" in qos:
        # a string that is not YAML is kept
        with suppress(ValueError):
            qos = load_yaml(qos)
    entry = {
        "name": topic.name,
        "type": topic.definition.name,
        "serialization_format": topic.encoding,
        "offered_qos_profiles": qos,
    }
    if hashed:
        entry["type_description_hash"] = metadata.get("topic_type_hash", "")
    return {"topic_metadata": entry, "message_count": 0}


@lru_cache(maxsize=8)
def _parsed(text: str) -> Any:
    """Return a YAML document with comments and quotes; cached between reading and editing."""
    return load_yaml(text, "rt")
