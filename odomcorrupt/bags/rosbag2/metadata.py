"""metadata.yaml: reading, editing, and creation where there was none."""

from __future__ import annotations

from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field
from functools import lru_cache
from io import StringIO
from typing import TYPE_CHECKING, Any, NamedTuple

from odomcorrupt.bags.rosbag2.bounded_yaml import load_faithful, load_plain, read_text, yaml_of, yaml_problem
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from odomcorrupt.bags.block import Definition, PartContents

_ROOT = "rosbag2_bagfile_information"


class TopicInfo(NamedTuple):
    """A topic of metadata.yaml."""

    name: str
    encoding: str
    definition: Definition


@dataclass(slots=True)
class Addition:
    """Messages that were added to a file of a bag.

    counts : messages by topic name
    """

    counts: dict[str, int] = field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int = 0

    def note(self, topic: str, log_ns: int) -> None:
        """Count a message."""
        self.counts[topic] = self.counts.get(topic, 0) + 1
        self.start_ns = log_ns if self.start_ns is None else min(self.start_ns, log_ns)
        self.end_ns = max(self.end_ns, log_ns)


def read_info(path: Path) -> dict[str, Any]:
    """Return the bag information of a metadata.yaml."""
    try:
        document = _parsed(read_text(path))
    except ValueError as error:
        raise BagError(
            f"{path}: cannot be read: {error}; without it the directory's files are read as they are"
        ) from error
    info = document.get(_ROOT) if isinstance(document, dict) else None
    if not isinstance(info, dict) or not isinstance(info.get("relative_file_paths"), list):
        raise BagError(f"{path}: is not a rosbag2 metadata.yaml; without it the directory's files are read as they are")
    return info


def edited(text: str, change: Callable[[dict[str, Any]], None]) -> str:
    """Return a YAML text with its bag information changed, all else unchanged."""
    out = StringIO()
    try:
        document = deepcopy(_parsed(text))
        change(document.get(_ROOT, document))
        yaml_of("rt").dump(document, out)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise BagError(f"metadata: not as rosbag2 writes it ({yaml_problem(error)}); remove metadata.yaml") from error
    return out.getvalue()


def add_provenance(info: dict[str, Any], name: str, items: Mapping[str, str]) -> None:
    """Add provenance metadata to custom_data."""
    custom = info.get("custom_data") or {}
    info["custom_data"] = {**custom, **{f"{name}.{key}": value for key, value in items.items()}}


def added(info: dict[str, Any], additions: list[Addition], topics: Mapping[str, TopicInfo]) -> None:
    """Add the counts and times of added messages.

    additions : by file, in the order of the file list
    topics : topics of added messages, by name
    """
    entries = {entry["topic_metadata"]["name"]: entry for entry in info.get("topics_with_message_count") or []}
    files = info.get("files") or [{} for _ in additions]
    for file, addition in zip(files, additions, strict=False):
        if addition.start_ns is None:
            continue
        for topic, count in addition.counts.items():
            if topic not in entries:
                hashed = any("type_description_hash" in entry["topic_metadata"] for entry in entries.values())
                entries[topic] = _topic_entry(topics[topic], hashed=hashed)
                info["topics_with_message_count"].append(entries[topic])
            entries[topic]["message_count"] += count
        for span in (info, file):
            if "message_count" in span:
                span["message_count"] += sum(addition.counts.values())
                _extend(span, addition.start_ns, addition.end_ns)


def set_compression(info: dict[str, Any], mode: str, names: list[str]) -> None:
    """State what of a bag is compressed, and the names of its files."""
    info["compression_mode"] = "" if mode == "none" else mode.upper()
    info["compression_format"] = "" if mode == "none" else "zstd"
    info["relative_file_paths"] = names
    for file, name in zip(info.get("files") or [], names, strict=False):
        file["path"] = name


def generated(
    storage: str, parts: list[PartContents], topics: list[TopicInfo], distro: str, *, root: bool = True
) -> str:
    """Return a new metadata.yaml for a bag that had none.

    root : whether the information is under its key, as in the file; the metadata table of sqlite3 has it bare
    """
    counts: dict[str, int] = {}
    for part in parts:
        for topic, count in part.counts.items():
            counts[topic] = counts.get(topic, 0) + count
    filled = [part for part in parts if part.counts]
    start_ns = min((part.start_ns for part in filled), default=0)
    once = {(topic.name, topic.definition.name): topic for topic in reversed(topics)}
    entries = [_topic_entry(topic, hashed=True) for topic in reversed(once.values())]
    for entry in entries:
        entry["message_count"] = counts.get(entry["topic_metadata"]["name"], 0)
    named = any(isinstance(entry["topic_metadata"]["offered_qos_profiles"], list) for entry in entries)
    info = {
        "version": 9 if named else 8,
        "storage_identifier": storage,
        "duration": {"nanoseconds": max((part.end_ns for part in filled), default=0) - start_ns},
        "starting_time": {"nanoseconds_since_epoch": start_ns},
        "message_count": sum(counts.values()),
        "topics_with_message_count": entries,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [part.name for part in parts],
        "files": [
            {
                "path": part.name,
                "starting_time": {"nanoseconds_since_epoch": part.start_ns},
                "duration": {"nanoseconds": part.end_ns - part.start_ns},
                "message_count": sum(part.counts.values()),
            }
            for part in parts
        ],
        "custom_data": {},
        "ros_distro": distro,
    }
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
            qos = load_plain(qos)
    entry = {
        "name": topic.name,
        "type": topic.definition.name,
        "serialization_format": topic.encoding,
        "offered_qos_profiles": qos,
    }
    if hashed:
        entry["type_description_hash"] = metadata.get("topic_type_hash", "")
    return {"topic_metadata": entry, "message_count": 0}


def _extend(span: dict[str, Any], start_ns: int, end_ns: int) -> None:
    before_ns = span["starting_time"]["nanoseconds_since_epoch"]
    after_ns = max(before_ns + span["duration"]["nanoseconds"], end_ns)
    span["starting_time"]["nanoseconds_since_epoch"] = min(before_ns, start_ns)
    span["duration"]["nanoseconds"] = after_ns - min(before_ns, start_ns)


@lru_cache(maxsize=8)
def _parsed(text: str) -> Any:
    """Return a YAML document with comments and quotes; cached between reading and editing."""
    return load_faithful(text)
