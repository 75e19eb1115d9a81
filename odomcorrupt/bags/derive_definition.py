"""The definition of a topic that is made beside another one, of another type."""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.bags.definition import Definition, ros_type

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odomcorrupt.bags.block import BagReader

__all__ = ["retyped"]

_TYPED = ("md5sum", "topic_type_hash", "type")
"""Metadata that belong to the type, not to the topic."""


def retyped(reader: BagReader, msgtype: str, encoding: str, like: Definition) -> Definition:
    """Define a type for a topic that is otherwise like another one: as the bag itself does, or as commonly known."""
    for other in reader.channels.values():
        if (other.msgtype, other.encoding) == (msgtype, encoding):
            found = reader.definition(other)
            typed = {key: found.metadata[key] for key in _TYPED if key in found.metadata}
            return found._replace(metadata={**_without(like.metadata, _TYPED), **typed})
    kind = ros_type(msgtype, encoding)
    values = {"md5sum": kind.digest, "topic_type_hash": kind.digest, "type": kind.name}
    metadata = {**like.metadata, **{key: value for key, value in values.items() if key in like.metadata}}
    return Definition(kind.name, "ros1msg" if encoding == "ros1" else "ros2msg", kind.text.encode(), metadata)


def _without(metadata: Mapping[str, str], keys: tuple[str, ...]) -> dict[str, str]:
    return {key: value for key, value in metadata.items() if key not in keys}
