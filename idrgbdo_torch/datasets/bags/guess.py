"""Topics by what is in their messages, for recordings of which the list of topics is lost or damaged."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from itertools import islice
from typing import Any

from ..bag_files import damage
from ..ros_images import COLOR_ENCODINGS, DEPTH_ENCODINGS
from ..ros_topics import namespace_of
from .storage import NAME, Storage

IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
LOOK_AT = 5  # messages, of which some may be damaged
LETTERS = 2  # of a name that damage in one place changes
LEAST = 3  # of them that are images, so that a topic is believed that nothing names
MOST_GUESSED = 1000  # topics


Deserialize = Callable[[bytes, str], Any]
Content = tuple[str, str, Any]  # color, depth or info; type; a message


def complete(storage: Storage, deserialize: Deserialize, types: Container[str]) -> str:
    """Tell the topics whose name or type is lost, or is none of `types`, and say which; empty where there are none.

    What can be read of a name stays. A few messages of no topic, as damage leaves them, make none.
    """
    if not any(name for name, _ in storage.topics.values()):
        storage.topics = guessed_topics(storage, deserialize, dict.fromkeys(storage.topics, 1))
        names = ", ".join(sorted({name for name, _ in storage.topics.values()}))
        return f"the names of the topics are lost; by what is in them they are {names}" if storage.topics else ""
    claimed = {channel for channel, _, _ in storage.other_names}
    lost = {channel for channel, (_, kind) in storage.topics.items() if kind not in types} - claimed
    least = dict.fromkeys(lost, 1) | dict.fromkeys(storage.nameless() - claimed, LEAST)
    guessed = guessed_topics(storage, deserialize, least)
    for channel, (name, kind) in guessed.items():
        own, _ = storage.topics.get(channel, ("", ""))
        readable = NAME.fullmatch(own) and own not in types  # which is what another table has there
        storage.topics[channel] = own if readable else name, kind
    names = ", ".join(sorted(storage.topics[channel][0] for channel in guessed))
    return f"topics whose name or type is lost are images or calibrations by what is in them: {names}" if names else ""


def unite(storages: Sequence[Storage]) -> list[str]:
    """Give what has several names, of which one is damaged, the other one; what is to be said of it.

    A channel has two names where two places of its file differ: the one that other files have, or that has topics
    beside it, is right. Where one topic of one of several files has a name that no other file has, it gets that of the
    others that differs in a letter or two.
    """
    said = []
    for storage in storages:
        elsewhere = {about for other in storages if other is not storage for about in other.topics.values()}
        for channel, name, kind in sorted(claim for claim in storage.other_names if claim[0] in storage.topics):
            beside = {namespace_of(topic) for key, (topic, _) in storage.topics.items() if key != channel}
            names = storage.topics[channel], (name, kind)
            ranks = [(about in elsewhere, namespace_of(about[0]) in beside) for about in names]
            if ranks[0] != ranks[1] and names[0][1] == kind:
                storage.topics[channel] = names[ranks[1] > ranks[0]]
                storage.other_names.discard((channel, name, kind))
        own = {channel: about for channel, about in storage.topics.items() if about not in elsewhere}
        for channel, (name, kind) in own.items() if len(own) == 1 < len(storage.topics) else ():
            missing = sorted(elsewhere - set(storage.topics.values()))
            alike = [about for about in missing if about[1] == kind and _apart(about[0], name) <= LETTERS]
            if len(alike) == 1:
                storage.topics[channel] = alike[0]
                said.append(f"'{name}' of one of the files is taken for {alike[0][0]} of the others")
    return said


def _apart(a: str, b: str) -> int:
    """How many letters differ."""
    return sum(x != y for x, y in zip(a, b, strict=True)) if len(a) == len(b) else max(len(a), len(b))


def guessed_topics(storage: Storage, deserialize: Deserialize, least: Mapping[int, int]) -> dict[int, tuple[str, str]]:
    """Name and type of each of the channels with images or calibrations: /color/image_raw, /depth/image_raw and so on.

    least: how many of a channel's first messages must be images, for each channel to be looked at. Further topics of a
    kind have a number. A calibration belongs to the colour images of the same frame and size.
    """
    told: dict[int, Content] = {}
    for channel in sorted(least)[:MOST_GUESSED]:
        messages = islice(storage.messages([channel]), LOOK_AT)
        found = [content for _, data in messages if (content := _kind(data, deserialize)) is not None]
        if found and (len(found) >= least[channel] or found[0][0] == "info"):
            told[channel] = found[0]
    names: dict[int, tuple[str, str]] = {}
    cameras: dict[tuple[str, int, int], str] = {}  # prefix by the frame of the header, and the size
    for kind in ("color", "depth"):
        channels = [channel for channel, about in told.items() if about[0] == kind]
        for count, channel in enumerate(channels):
            _, msgtype, message = told[channel]
            prefix = f"/{kind}_{count}" if count else f"/{kind}"
            names[channel] = f"{prefix}/{'image_raw' if msgtype == IMAGE else 'image_raw/compressed'}", msgtype
            cameras.setdefault((message.header.frame_id, 0, 0), prefix)
            if msgtype == IMAGE:
                cameras.setdefault((message.header.frame_id, message.width, message.height), prefix)
    for channel, (kind, msgtype, message) in told.items():
        if kind == "info":
            frame = message.header.frame_id
            prefix = cameras.get((frame, message.width, message.height), cameras.get((frame, 0, 0), f"/{channel}"))
            names[channel] = f"{prefix}/camera_info", msgtype
    return names


def _kind(data: bytes, deserialize: Deserialize) -> Content | None:
    """What a message holds, where that can be told beyond doubt."""
    for msgtype in (IMAGE, COMPRESSED, INFO):
        try:
            message = deserialize(data, msgtype)
        except damage():
            continue
        if msgtype == IMAGE and 0 < message.step * message.height <= len(message.data):
            for kind, encodings in (("color", COLOR_ENCODINGS), ("depth", DEPTH_ENCODINGS)):
                if message.encoding in encodings:
                    return kind, msgtype, message
        if msgtype == COMPRESSED and message.format.isprintable() and message.data[:1].tobytes() in (b"\x89", b"\xff"):
            return "color", msgtype, message
        if msgtype == COMPRESSED and "compressedDepth" in message.format:
            return "depth", msgtype, message
        if msgtype == INFO and message.width > 0 < message.height:
            return "info", msgtype, message
    return None
