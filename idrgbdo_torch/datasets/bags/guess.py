"""Topics by what is in their messages, for recordings of which the list of topics is lost."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from typing import Any

from ..bag_files import damage
from ..ros_images import COLOR_ENCODINGS, DEPTH_ENCODINGS
from .storage import Storage

IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
LOOK_AT = 5  # messages, of which some may be damaged
MOST_GUESSED = 1000  # topics


def guessed_topics(storage: Storage, deserialize: Callable[[bytes, str], Any]) -> dict[int, tuple[str, str]]:
    """Name and type of each channel with images or calibrations: /color/image_raw, /depth/image_raw and the like.

    Further topics of a kind have a number. A calibration belongs to the colour images of the same frame and size.
    """
    told: dict[int, tuple[str, str, Any]] = {}  # kind of content, type, a message
    for channel in sorted(storage.topics)[:MOST_GUESSED]:
        for _, data in islice(storage.messages([channel]), LOOK_AT):
            found = _kind(data, deserialize)
            if found is not None:
                told[channel] = found
                break
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


def _kind(data: bytes, deserialize: Callable[[bytes, str], Any]) -> tuple[str, str, Any] | None:
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
