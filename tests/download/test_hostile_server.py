"""Servers and archives without end, hurry or sense: each ends in one line, soon, and leaves nothing."""

from __future__ import annotations

import gzip
import io
import socket
import tarfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.download import fetch as fetching
from idrgbdo_torch.download.extract import extract
from idrgbdo_torch.download.fetch import check_sum, fetch
from idrgbdo_torch.download.tum import TUM_SEQUENCES, most_bytes
from idrgbdo_torch.errors import IdRgbdoError

Send = Callable[[bytes], None]


@contextmanager
def answering(answer: Callable[[Send], None]) -> Iterator[str]:
    """A server that reads the head of each request and then does what `answer` does; its address."""
    listener = socket.create_server(("127.0.0.1", 0))
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            with suppress(OSError):
                connection, _ = listener.accept()
                with connection:
                    connection.recv(65536)
                    answer(connection.sendall)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        ended.set()
        listener.close()


def without_end(send: Send) -> None:
    send(b"HTTP/1.1 200 OK\r\n\r\n")
    while True:
        send(bytes(1 << 16))


def too_long(send: Send) -> None:
    send(b"HTTP/1.1 200 OK\r\nContent-Length: 99999999999\r\n\r\n")


@pytest.mark.parametrize("answer", [without_end, too_long])
def test_a_body_larger_than_the_file_can_be_is_refused(tmp_path: Path, answer: Callable[[Send], None]) -> None:
    with answering(answer) as url, pytest.raises(IdRgbdoError, match="larger than the 5000000 bytes"):
        fetch(f"{url}/a", tmp_path / "a", most_bytes=5_000_000, wait_s=0)
    assert not (tmp_path / "a").exists() and not (tmp_path / "a.part").exists()


def page_without_end(send: Send) -> None:
    send(b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/a\r\n\r\n")
    while True:
        send(bytes(1 << 16))


def page_of_nonsense(send: Send) -> None:
    send(b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/a\r\nContent-Length: %d\r\n\r\n" % 10**30)


@pytest.mark.parametrize("answer", [page_without_end, page_of_nonsense])
def test_the_page_of_a_redirection_is_not_read(tmp_path: Path, answer: Callable[[Send], None]) -> None:
    begin = time.monotonic()
    with answering(answer) as url, pytest.raises(IdRgbdoError, match="refused"):
        fetch(f"{url}/a", tmp_path / "a", tries=2, wait_s=0)
    assert time.monotonic() - begin < 5


def drop_by_drop(send: Send) -> None:
    send(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n")
    for _ in range(1000):
        send(b"x")
        time.sleep(0.02)


def test_a_body_that_never_gets_done_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetching, "SLOW_S", 0.3)
    begin = time.monotonic()
    with answering(drop_by_drop) as url, pytest.raises(IdRgbdoError, match="less than 1000 bytes a second"):
        fetch(f"{url}/a", tmp_path / "a", wait_s=0)
    assert time.monotonic() - begin < 5


def head_by_head(send: Send) -> None:
    send(b"HTTP/1.1 200 OK\r\n")
    for number in range(1000):
        send(b"X-%d: 1\r\n" % number)
        time.sleep(0.05)


def test_a_head_that_never_ends_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetching, "OPEN_S", 0.2)
    begin = time.monotonic()
    with answering(head_by_head) as url, pytest.raises(IdRgbdoError, match="failed 2 times in a row"):
        fetch(f"{url}/a", tmp_path / "a", tries=2, wait_s=0)
    assert time.monotonic() - begin < 5


@pytest.mark.parametrize(
    "head",
    [
        b"HTTP/1.1 302 Found\r\nLocation: file:///etc/passwd\r\n\r\n",
        b"HTTP/1.1 302 Found\r\nLocation: ftp://127.0.0.1/a\r\n\r\n",
        b"HTTP/1.1 302 Found\r\nLocation: http://[\r\n\r\n",
        b"HTTP/1.1 302 Found\r\nLocation: http://\xff\xfe/\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: " + b"9" * 5000 + b"\r\n\r\nbody",
        b"HTTP/1.1 206 Partial\r\nContent-Range: bytes 0-1/" + b"9" * 5000 + b"\r\n\r\nbody",
        b"HTTP/1.1 206 Partial\r\n\r\n",
        b"HTTP/1.1 -1 \x1b[31m\r\n\r\n",
        b"nonsense\r\n\r\n",
        b"",
    ],
)
def test_answers_without_sense(tmp_path: Path, head: bytes) -> None:
    with answering(lambda send: send(head)) as url, suppress(IdRgbdoError):
        fetch(f"{url}/a", tmp_path / "a", tries=2, wait_s=0)
        assert (tmp_path / "a").read_bytes() == b"body"  # a length that is no number is none


@pytest.mark.parametrize(
    "url",
    ["nonsense", "", "http://", "http://[", "file:///etc/passwd", "ftp://x/y", "http://a b/", "http://x:99999999/",
     "http://x:0/", "data:,x", "http://\x1b[31m/", "http://é/"],
)  # fmt: skip
def test_addresses_without_sense_are_refused_at_once(
    url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begin = time.monotonic()
    with pytest.raises(IdRgbdoError, match="expected an address"):
        fetch(url, tmp_path / "a")
    if url:
        assert main(["download", "tum", "fr1_xyz", "--out", str(tmp_path), "--url", url]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and "\x1b" not in error
    assert time.monotonic() - begin < 2


def test_a_status_text_moves_no_cursor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with answering(lambda send: send(b"HTTP/1.1 404 \x1b[2Jgone\r\n\r\n")) as url:
        assert main(["download", "tum", "fr1_xyz", "--out", str(tmp_path), "--url", url]) == 1
    error = capsys.readouterr().err
    assert "\\x1b[2Jgone" in error and "\x1b" not in error


def packed(members: list[tuple[tarfile.TarInfo, bytes]]) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz", format=tarfile.PAX_FORMAT) as tar:
        for member, data in members:
            member.size = member.size or len(data)
            tar.addfile(member, io.BytesIO(data))
    return stream.getvalue()


def deep() -> bytes:
    return packed([(tarfile.TarInfo("/".join(["d"] * 2000)), b"")])


def headers_upon_headers() -> bytes:
    header = tarfile.TarInfo("x")
    header.type, header.size = tarfile.XHDTYPE, 512
    record = b"12 path=s/a\n"
    block = header.tobuf(tarfile.USTAR_FORMAT) + record.ljust(512, b"\0")
    return gzip.compress(block * 20_000)


def holes() -> bytes:
    member = tarfile.TarInfo("s/hole")
    member.pax_headers = {"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.realsize": str(8 << 30)}
    return packed([(member, b"1\n0\n512\n".ljust(512, b"\0") + bytes(512))])


def negative() -> bytes:
    member = tarfile.TarInfo("s/a")
    block = bytearray(member.tobuf(tarfile.GNU_FORMAT))
    block[124:136] = b"\xff" * 11 + b"\0"
    block[148:156] = b"%06o\0 " % (256 + sum(block[:148]) + sum(block[156:512]))
    return gzip.compress(bytes(block) + bytes(1024))


def many_empty() -> bytes:
    return packed([(tarfile.TarInfo(f"s/{number}"), b"") for number in range(3000)])


def escape() -> bytes:
    return packed([(tarfile.TarInfo("s/\x1b[2J"), b"x")])


@pytest.mark.parametrize("make", [deep, headers_upon_headers, holes, negative, many_empty, escape])
def test_archives_that_cost_nothing_to_make_cost_nothing_to_refuse(tmp_path: Path, make: Callable[[], bytes]) -> None:
    (tmp_path / "a.tgz").write_bytes(make())
    begin = time.monotonic()
    with pytest.raises(IdRgbdoError, match="archive"):
        extract(tmp_path / "a.tgz", tmp_path / "seq", most_files=2000)
    assert time.monotonic() - begin < 10
    assert [path.name for path in tmp_path.iterdir()] == ["a.tgz"]


def test_contents_that_are_many_times_the_archive_are_refused(tmp_path: Path) -> None:
    member = tarfile.TarInfo("s/zeros")
    (tmp_path / "a.tgz").write_bytes(packed([(member, bytes(80 << 20))]))
    with pytest.raises(IdRgbdoError, match="more than"):
        extract(tmp_path / "a.tgz", tmp_path / "seq")


def test_every_sequence_has_a_limit_above_what_it_is() -> None:
    for name in TUM_SEQUENCES:
        assert 0.5e9 < most_bytes(name) < 8e9
    assert len(TUM_SEQUENCES) == 18


def test_a_list_of_sums_that_is_a_folder_or_of_other_letters(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x")
    (tmp_path / "sums").write_bytes(b"\xff\xfe  b\n")
    check_sum(tmp_path / "a", tmp_path / "sums")
    assert (tmp_path / "sums").read_bytes().startswith(b"\xff\xfe  b\n")
    (tmp_path / "folder").mkdir()
    with pytest.raises(IdRgbdoError, match="cannot read"):
        check_sum(tmp_path / "a", tmp_path / "folder")
