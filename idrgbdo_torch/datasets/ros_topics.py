"""Which of a recording's topics are the colour and the depth of one camera."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from ..errors import IdRgbdoError

REGISTERED = re.compile(r"aligned_depth|depth_registered|depth_to_(rgb|color)|registered")
TO_DEPTH = re.compile(r"(rgb|colou?r)_to_depth", re.IGNORECASE)  # colour that was registered to depth
NO_COLOR = re.compile(r"depth|infra|(^|[/_])ir([/_]|$)|mask|label|segment|disparity|normal|confidence", re.IGNORECASE)
COLORFUL = re.compile(r"rgb|colou?r", re.IGNORECASE)
# words of a topic that tell what is in it, and not which camera it comes from
KINDS = {
    *("color", "colour", "rgb", "mono", "depth", "stereo", "aligned", "to", "registered", "hw", "sw"),
    *("image", "img", "raw", "rect", "rectified", "optical", "data", "metres", "compressed", "compresseddepth"),
}

T = TypeVar("T")


@dataclass(frozen=True)
class Topic(Generic[T]):
    """An image topic."""

    name: str
    raw: bool  # rather than compressed
    filled: bool  # there is a message that is more than a header
    connection: T
    deep: bool = False  # what is in its messages is depth

    @property
    def camera(self) -> tuple[str, ...]:
        """The words of its name that tell the camera: ("left",) of /left/aligned_depth_to_color/image_raw."""
        return tuple(word for word in re.split(r"[/_]", self.name.lower()) if word and word not in KINDS)


def choose_topics(
    topics: Sequence[Topic[T]],
    color: str | None,
    depth: str | None,
    frame_id: Callable[[Topic[T]], str],
    where: str,
) -> tuple[Topic[T], Topic[T], tuple[str, ...]]:
    """The colour and the depth topic, and warnings. color, depth: as the user names them.

    Both are of one camera by their names, or by the frames that their headers name (`frame_id` of a topic). Depth that
    is registered to colour goes first. Raises IdRgbdoError, listing what is there, where a topic is missing or it
    cannot be told which belong together.
    """
    unnamed = []  # as where the name is damaged
    if depth is None and not any(_is_depth(topic) for topic in topics):
        unnamed = [topic for topic in topics if topic.deep and _is_color(topic) and topic.name != color]
    topics = [topic for topic in topics if topic not in unnamed]
    colors = _candidates(topics, "color", color, where)
    depths = unnamed or _candidates(topics, "depth", depth, where)
    said = tuple(f"no topic is called depth; by what is in it, {topic.name} is" for topic in unnamed)
    pairs = [(c, d) for c in colors for d in depths if c.camera == d.camera]
    if not pairs and len({c.camera for c in colors}) == 1 == len({d.camera for d in depths}):
        # one camera each, whatever they are called; unless another topic shows that they are two
        apart = any(_is_color(t) and t.camera == depths[0].camera for t in topics)
        if not apart or (color is not None and depth is not None):
            pairs = [(colors[0], depths[0])]
    if not pairs:
        pairs = _by_frame(colors, depths, frame_id)
    if not pairs:
        raise IdRgbdoError(
            f"{where}: cannot tell which colour and which depth topic are of one camera: colour "
            f"{_listed(colors)}; depth {_listed(depths)}; name one with --color-topic and one with --depth-topic"
        )
    best = min(pairs, key=lambda pair: (not _registered(*pair), _order_depth(pair[1]), _order_color(pair[0])))
    others = sorted({f"{c.name} with {d.name}" for c, d in pairs if c.camera != best[0].camera})
    if not others:
        return *best, said
    warning = (
        f"the recording has several cameras; {best[0].name} is read with {best[1].name}; others: {', '.join(others)}: "
        "choose with --color-topic"
    )
    return *best, (*said, warning)


def namespace_of(topic: str) -> str:
    """What a topic of images and that of their camera_info have in common."""
    return re.sub(r"/(compressed|compressedDepth)$", "", topic).rsplit("/", 1)[0]


def _candidates(topics: Sequence[Topic[T]], kind: str, name: str | None, where: str) -> list[Topic[T]]:
    """The topics that can be colour or depth, the likeliest first. Raises IdRgbdoError where there is none."""
    if name is not None:
        found = [topic for topic in topics if topic.name == name]
    elif kind == "depth":
        found = sorted(filter(_is_depth, topics), key=_order_depth)
    else:
        found = sorted(filter(_is_color, topics), key=_order_color)
    if not found:
        wanted = f"the topic '{name}'" if name else f"a {kind} topic"
        raise IdRgbdoError(
            f"{where}: expected {wanted} with images, found these: {_listed(topics)}; name one with --{kind}-topic"
        )
    filled = [topic for topic in found if topic.filled]
    if not filled:
        raise IdRgbdoError(
            f"{where}: expected images, but the messages of {_listed(found)} are empty; record another topic, or name "
            f"one with --{kind}-topic"
        )
    return filled


def _is_depth(topic: Topic[T]) -> bool:
    return "depth" in topic.name.lower() and not TO_DEPTH.search(topic.name)


def _is_color(topic: Topic[T]) -> bool:
    return TO_DEPTH.search(topic.name) is not None or not NO_COLOR.search(topic.name)


def _registered(color: Topic[T], depth: Topic[T]) -> bool:
    """Whether the names say that one was registered to the other."""
    return (TO_DEPTH.search(color.name) is None) == (REGISTERED.search(depth.name) is not None)


def _by_frame(
    colors: Iterable[Topic[T]], depths: Iterable[Topic[T]], frame_id: Callable[[Topic[T]], str]
) -> list[tuple[Topic[T], Topic[T]]]:
    """The pairs that lie in one frame, where that leaves one camera."""
    frames = {topic.name: frame_id(topic) for topic in (*colors, *depths)}
    pairs = [(c, d) for c in colors for d in depths if frames[c.name] and frames[c.name] == frames[d.name]]
    return pairs if len({c.camera for c, _ in pairs}) == 1 else []


def _order_color(topic: Topic[T]) -> tuple[bool, bool, int, str]:
    return not COLORFUL.search(topic.name), not topic.raw, len(topic.name), topic.name


def _order_depth(topic: Topic[T]) -> tuple[bool, bool, int, str]:
    return not REGISTERED.search(topic.name), not topic.raw, len(topic.name), topic.name


def _listed(topics: Iterable[Topic[T]]) -> str:
    return ", ".join(sorted({topic.name for topic in topics})) or "none"
