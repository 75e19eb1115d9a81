"""Message types of ROS 1 and ROS 2 in terms of each other: definition, hash, and conversion of serialised messages.

Types that the other generation has are written as it has them (those of ROS Noetic and ROS 2 Humble), so that its own
programs read them; other types keep their fields. Serialisation, definitions and hashes are those of the rosbags
library, which `rosbags-convert` uses, too.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from rosbags.convert.converter import LATCH, is_same_wireformat, migrate_bytes
from rosbags.interfaces import Nodetype
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore

from odomcorrupt.bags.definition import plain_text
from odomcorrupt.bags.rosbag2.bounded_yaml import load_yaml
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rosbags.typesys.store import Typestore

    from odomcorrupt.bags.block import Definition


_TRANSIENT_LOCAL = (1, "1", "transient_local")
"""As metadata of all versions name it."""


@lru_cache(maxsize=1)
def latched_qos() -> str:
    """Return the profile of a publisher that latches its last message: reliable and transient local."""
    return dump_qos_v8(list(LATCH))


def stays_for_late_subscribers(profiles: str) -> bool:
    """Return whether some publisher's last messages are sent to late subscribers: durability is transient local."""
    try:
        offered: Any = load_yaml(profiles) if profiles else []
    except ValueError:
        return False
    if not isinstance(offered, list):
        return False
    return any(isinstance(one, dict) and one.get("durability") in _TRANSIENT_LOCAL for one in offered)


Generation = Literal[1, 2]
"""Of ROS."""

_RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
"""Types of ROS 1 that ROS 2 has under another name."""
_MISSING_IN_NOETIC = {"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"}
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)+")
_LONGEST_CHARACTERS = 1 << 18
"""Of a definition; the longest of common packages have a tenth."""
_MOST_TYPES = 1000
_MOST_ELEMENTS = 1 << 16
"""Of strings and messages in arrays of fixed length: code is generated for each of them."""
_IDL_SEPARATOR = "=" * 80 + "\n"
_SECTION = "IDL: "

_Damage = (
    SerdeError, TypesysError, struct.error, ValueError, KeyError, IndexError, TypeError, AttributeError, AssertionError,
    SyntaxError, OverflowError, RecursionError, MemoryError,
)  # fmt: skip
"""What the library raises on definitions and messages that are not what they say."""

Fields = tuple[list[Any], list[tuple[str, Any]]]
"""Constants and fields of a type, as the library has them."""


class MessageType(NamedTuple):
    """A message type in the other generation of ROS.

    msgtype : name, in ROS 2 notation
    text : definition with those of nested types, as stored in bags
    digest : the md5sum of ROS 1, the RIHS01 hash of ROS 2
    convert : function from a serialised message of the one to that of the other; raises BagError
    lost : fields that the other generation's type does not have
    """

    msgtype: str
    text: str
    digest: str
    convert: Callable[[memoryview], bytes | memoryview]
    lost: tuple[str, ...] = ()


def convert_type(msgtype: str, definition: Definition, ros: Generation) -> MessageType:
    """Return a type of the other generation in terms of `ros`.

    msgtype : name, in ROS 2 notation
    definition : that of the bag; where it has none, or no nested ones, common types are known
    ros : generation of the result, 1 or 2

    Raises
    ------
    BagError
        If the definition is missing, incomplete or invalid, or the type cannot exist in the other generation.
    """
    other: Generation = 1 if ros == 2 else 2
    new = _RENAMED.get(msgtype, msgtype) if ros == 2 else msgtype
    if not _NAME.fullmatch(msgtype):
        # code is generated under this name
        raise BagError(f"{msgtype[:80]!r} is not a message type")
    try:
        given = _parsed(msgtype, definition, known=msgtype in _common(other))
        source = _closure(msgtype, {**_common(other), **given})
        wanted = {**source, **_common(ros)} if ros == 2 else {**_without_bounds(source), **_common(ros)}
        if new != msgtype and new not in wanted:
            wanted[new] = wanted[msgtype]
        target = _closure(new, wanted)
        stores = _Stores(_store(source), _store(target))
        text, md5sum = stores.target.generate_msgdef(new, ros_version=ros)
        digest = md5sum if ros == 1 else stores.target.hash_rihs01(new)
        converter = _Converter(stores, msgtype, new, ros)
        lost = () if converter.direct else _lost(source, target, msgtype, new)
    except _Damage as error:
        raise BagError(f"{msgtype}: {_reason(error)}") from error
    return MessageType(new, text, digest, converter, lost)


@dataclass(frozen=True, slots=True)
class _Stores:
    """Types of the input and of the output."""

    source: Typestore
    target: Typestore


class _Converter:
    """Function that converts one message."""

    def __init__(self, stores: _Stores, msgtype: str, new: str, ros: Generation) -> None:
        self._stores = stores
        self._msgtype = msgtype
        self.direct = is_same_wireformat(stores.source, stores.target, msgtype, new)
        self._from_cdr = ros == 1
        self._quick: Any = None
        if self.direct and self._from_cdr:
            self._quick = partial(stores.source.cdr_to_ros1, typename=msgtype)
        elif self.direct:
            self._quick = partial(stores.target.ros1_to_cdr, typename=new)
        self._migrate = partial(
            migrate_bytes, stores.source, stores.target, msgtype, new, {}, src_is2=ros == 1, dst_is2=ros == 2
        )

    def __call__(self, data: memoryview) -> bytes | memoryview:
        # no list has more elements than its message has bytes
        self._stores.source.max_sequence_length = self._stores.target.max_sequence_length = max(len(data), 1)
        big_endian = self._from_cdr and bytes(data[:2]) == b"\0\0"
        try:
            out: memoryview = self._migrate(data) if self._quick is None or big_endian else self._quick(data)
        except _Damage as error:
            raise BagError(f"{self._msgtype}: a message of {len(data)} bytes is not of this type: {error}") from error
        return out


def _reason(error: BaseException) -> str:
    if isinstance(error, KeyError | AttributeError | AssertionError | IndexError | RecursionError | MemoryError):
        return "its definition cannot be used"
    return " ".join(str(error).split())[:200]


def _parsed(msgtype: str, definition: Definition, *, known: bool) -> dict[str, Fields]:
    """Return the types of a bag's definition text; none where there is no text, or that of a known type is lost."""
    if "/action/" in msgtype or "/srv/" in msgtype:
        raise ValueError("services and actions have no counterpart")
    text = plain_text(definition)
    if len(text) > _LONGEST_CHARACTERS:
        raise ValueError(f"its definition has {len(text)} characters, which no recorder writes")
    if not text.strip() and (known or definition.encoding not in ("ros1msg", "ros2msg")):
        return {}
    if definition.encoding != "ros2idl":
        return dict(get_types_from_msg(text, msgtype))
    found: dict[str, Fields] = {}
    for section in text.split(_IDL_SEPARATOR) if text.startswith(_IDL_SEPARATOR + _SECTION) else [text]:
        body = section.partition("\n")[2] if section.startswith(_SECTION) else section
        if body.strip():
            found.update(get_types_from_idl(body))
    return found


@lru_cache(maxsize=2)
def _common(ros: Generation) -> Mapping[str, Fields]:
    """Return the types that every installation of ROS Noetic, or of ROS 2 Humble, has."""
    found: dict[str, Fields] = dict(get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE).fielddefs)
    if ros == 1:
        for name in _MISSING_IN_NOETIC:
            found |= get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name)
    return found


def _store(types: Mapping[str, Fields]) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register(dict(types))
    return store


def _nested(description: Any) -> tuple[str | None, int]:
    """Return the message type in a field, None for none, and how many of them code is generated for."""
    kind, rest = description
    if kind == Nodetype.NAME:
        return rest, 1
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        (inner, name), count = rest
        fixed = count if kind == Nodetype.ARRAY else 1
        unrolled = inner == Nodetype.NAME or name[0] == "string"
        return (name if inner == Nodetype.NAME else None), (fixed if unrolled else 1)
    return None, 1


def _closure(name: str, types: Mapping[str, Fields]) -> dict[str, Fields]:
    """Return a type and all types nested in it."""
    found: dict[str, Fields] = {}
    sizes: dict[str, int] = {}

    def visit(one: str, above: tuple[str, ...]) -> int:
        if one in above:
            raise ValueError(f"{one} contains itself")
        if one in sizes:
            return sizes[one]
        if one not in types:
            what = "it has no definition" if one == name else f"its definition lacks that of {one}"
            raise ValueError(f"{what}, which cannot be guessed")
        found[one] = types[one][:2]
        size = 1
        for _, description in types[one][1]:
            nested, count = _nested(description)
            size += count * (visit(nested, (*above, one)) if nested is not None else 1)
        if size > _MOST_ELEMENTS or len(found) > _MOST_TYPES:
            raise ValueError("its arrays of fixed length are too long, or its types too many")
        sizes[one] = size
        return size

    visit(name, ())
    return found


def _without_bounds(types: Mapping[str, Fields]) -> dict[str, Fields]:
    """Return types without limits of strings and lists, which ROS 1 does not know."""

    def plain(description: Any) -> Any:
        kind, rest = description
        if kind == Nodetype.BASE:
            return kind, (rest[0], 0)
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            return kind, (plain(rest[0]), rest[1] if kind == Nodetype.ARRAY else 0)
        return description

    return {
        name: (constants, [(field, plain(description)) for field, description in fields])
        for name, (constants, fields) in types.items()
    }


def _lost(source: Mapping[str, Fields], target: Mapping[str, Fields], old: str, new: str) -> tuple[str, ...]:
    """Return the fields of the source that the target has under no name, as the library's migration pairs them."""
    theirs = dict(target[new][1])
    gone = [(name, kind) for name, kind in source[old][1] if name not in theirs]
    mine = dict(source[old][1])
    for name, kind in target[new][1]:
        same = [one for one in gone if one[1] == kind] if name not in mine else []
        if same:
            gone.remove(same[0])
    found = [name for name, _ in gone if (old, name) != ("std_msgs/msg/Header", "seq")]
    for name, description in source[old][1]:
        nested, _ = _nested(description)
        if nested is not None and nested in target and name in theirs:
            found += [f"{name}.{field}" for field in _lost(source, target, nested, nested)]
    return tuple(found)
