"""Definition of an added topic with the publisher settings of another one."""

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
    """Return the definition of a type (the bag's own, or the common one) with the QoS and callerid of `like`."""
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
