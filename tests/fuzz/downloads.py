"""Attacks on the download: answers and archives of which anything may be spoiled."""

from __future__ import annotations

import gzip
import io
import socket
import tarfile
import threading
from pathlib import Path

from numpy.random import Generator

from idrgbdo_torch.download.extract import extract
from idrgbdo_torch.download.fetch import fetch

from .mutate import spoiled, words_spoiled
from .promise import refused

BODY = bytes(range(256)) * 8
HEAD = (
    'HTTP/1.1 {status}\r\nETag: "1"\r\nContent-Length: 2048\r\nContent-Range: bytes 0-2047/2048\r\n'
    "Location: http://127.0.0.1:1/a\r\nTransfer-Encoding: {coding}\r\n\r\n"
)


def answers(rng: Generator, folder: Path) -> None:
    """A server whose head is spoiled: the file as it is said to be, or a sentence."""
    status = ("200 OK", "206 Partial Content", "302 Found", "404 Gone", "503 Later")[rng.integers(5)]
    head = HEAD.format(status=status, coding=("chunked", "identity")[rng.integers(2)]).replace("\r\n", "\n")
    raw = words_spoiled(rng, head).replace("\n", "\r\n").encode("utf-8", "surrogateescape")
    answer = (raw if rng.random() < 0.7 else spoiled(rng, raw)) + BODY
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        for _ in range(8):
            try:
                connection, _ = listener.accept()
                with connection:
                    connection.recv(65536)
                    connection.sendall(answer)
            except OSError:
                return

    threading.Thread(target=serve, daemon=True).start()
    try:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}/a"
        refused(lambda: fetch(url, folder / "a", most_bytes=4096, tries=2, wait_s=0.0))
    finally:
        listener.close()
    assert {path.name for path in folder.iterdir()} <= {"a", "a.part", "a.part.json"}
    assert not (folder / "a").exists() or (folder / "a").stat().st_size <= 4096


def archives(rng: Generator, folder: Path) -> None:
    """A packed recording with anything spoiled: unpacked whole, or refused with nothing left behind."""
    stream = io.BytesIO()
    form = (tarfile.PAX_FORMAT, tarfile.GNU_FORMAT, tarfile.USTAR_FORMAT)[rng.integers(3)]
    with tarfile.open(fileobj=stream, mode="w", format=form) as tar:
        for name, data in (
            ("s/rgb.txt", b"# images\n"),
            ("s/rgb/1.png", BODY),
            ("s/" + "n" * (90 if form == tarfile.USTAR_FORMAT else 150), b""),
        ):
            member = tarfile.TarInfo(name)
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    plain = bytearray(stream.getvalue())
    if rng.random() < 0.7:  # a header with a right sum
        at = 512 * int(rng.integers(len(plain) // 512))
        for place in rng.integers(0, 345, int(rng.integers(1, 6))):
            plain[at + place] = (0, 0x20, 0x2F, 0x2E, 0x30, 0x37, 0x80, 0xFF, 0x4C, 0x78, 0x67)[rng.integers(11)]
        header = plain[at : at + 512]
        plain[at + 148 : at + 156] = b"%06o\0 " % (256 + sum(header[:148]) + sum(header[156:]))
        packed = gzip.compress(bytes(plain), 1)
    else:
        packed = spoiled(rng, gzip.compress(bytes(plain), 1))
    (folder / "a.tgz").write_bytes(packed)
    refused(lambda: extract(folder / "a.tgz", folder / "seq"))
    assert {path.name for path in folder.iterdir()} <= {"a.tgz", "seq"}
