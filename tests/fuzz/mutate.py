"""Ways to spoil bytes, numbers and texts."""

from __future__ import annotations

from numpy.random import Generator

TOKENS = (
    "nan", "inf", "-inf", "1e308", "1e999", "-1", "0", "9" * 400, "9" * 5000, "\x00", "\x1b[2J", "²", "٣", "\udcff",
    "[" * 3000, "{" * 3000, '"', "'", "../" * 8 + "etc/passwd", "/dev/zero", ",", "\r", "\u2028", "true", "null",
    "-0.0", "",
)  # fmt: skip


def spoiled(rng: Generator, data: bytes) -> bytes:
    """Other bytes than the given: flipped, cut, doubled, exchanged or with something put in."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        kind = rng.integers(6)
        a, b = sorted(rng.integers(0, len(out) + 1, 2).tolist())
        if kind == 0 and out:
            for place in rng.integers(0, len(out), int(rng.integers(1, 9))):
                out[place] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del out[a:]
        elif kind == 2:
            out[a:a] = out[a:b][:4096]
        elif kind == 3:
            del out[a : min(b, a + 64)]
        elif kind == 4:
            out[a:a] = rng.bytes(int(rng.integers(1, 64)))
        else:
            out[a:a] = token(rng).encode("utf-8", "surrogateescape")
    return bytes(out) if bytes(out) != data else bytes(out) + b"\x01"


def token(rng: Generator) -> str:
    """A piece of text that parsers do not love."""
    return TOKENS[int(rng.integers(len(TOKENS)))]


def words_spoiled(rng: Generator, text: str) -> str:
    """A text some of whose words or lines are others."""
    lines = text.split("\n")
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(lines)))
        words = lines[at].split(" ")
        words[int(rng.integers(len(words)))] = token(rng)
        lines[at] = " ".join(words)
        if rng.random() < 0.3:
            lines.insert(at, lines[int(rng.integers(len(lines)))])
    return "\n".join(lines)


def tree_spoiled(rng: Generator, tree: object) -> object:
    """A tree of JSON one of whose leaves or branches is another."""
    if rng.random() < 0.15 or not isinstance(tree, list | dict) or not tree:
        return [token(rng), int(rng.integers(-2, 1 << 40)), float(rng.normal()), None, [], {}, [0], True][
            rng.integers(8)
        ]
    if isinstance(tree, dict):
        key = list(tree)[int(rng.integers(len(tree)))]
        if rng.random() < 0.1:
            return {token(rng) if name == key else name: value for name, value in tree.items()}
        return {**tree, key: tree_spoiled(rng, tree[key])}
    at = int(rng.integers(len(tree)))
    if rng.random() < 0.1:
        return [*tree[:at], *tree[at + 1 :]]
    return [*tree[:at], tree_spoiled(rng, tree[at]), *tree[at + 1 :]]
