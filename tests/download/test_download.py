"""Downloads from a server that drops connections, and archives that want to do harm."""

from __future__ import annotations

import gzip
import hashlib
import io
import tarfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from idrgbdo_torch.commands.cli import main
from idrgbdo_torch.download import TUM_SEQUENCES, download_tum, long_name
from idrgbdo_torch.download.extract import extract
from idrgbdo_torch.download.fetch import check_sum, fetch
from idrgbdo_torch.errors import IdRgbdoError

NOISE = np.random.default_rng(0).bytes(400_000)


@dataclass
class Server:
    """What the server does, and what it was asked."""

    files: dict[str, bytes]
    drop_after: int | None = None  # bytes of each answer until the connection is cut
    drops: int = 10**9  # how many answers are cut
    ranges: bool = True
    etag: str | None = '"1"'
    chunked: bool = False
    statuses: list[int] = field(default_factory=list)  # answered instead, first come first served
    asked: list[tuple[str, str | None]] = field(default_factory=list)
    url: str = ""


def handler_of(server: Server) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            self.close_connection = True
            wanted = self.headers.get("Range")
            server.asked.append((self.path, wanted))
            if server.statuses:
                self.send_error(server.statuses.pop(0))
                return
            if self.path not in server.files:
                self.send_error(404)
                return
            data = server.files[self.path]
            valid = server.etag is not None and self.headers.get("If-Range") == server.etag
            start = int(wanted[6:].rstrip("-")) if wanted and valid and server.ranges else 0
            self.send_response(206 if start else 200)
            if start:
                self.send_header("Content-Range", f"bytes {start}-{len(data) - 1}/{len(data)}")
            if server.etag:
                self.send_header("ETag", server.etag)
            body = data[start:]
            cut = server.drop_after is not None and server.drops > 0
            if cut:
                server.drops -= 1
            sent = body[: server.drop_after] if cut else body
            if server.chunked:
                self.send_header("Transfer-Encoding", "chunked")
                self.end_headers()
                self.wfile.write(b"%x\r\n%s\r\n" % (len(sent), sent))
                if not cut:
                    self.wfile.write(b"0\r\n\r\n")
                return
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(sent)

        def log_message(self, *_: Any) -> None:
            pass

    return Handler


@contextmanager
def serving(**options: Any) -> Iterator[Server]:
    server = Server(**options)
    http = ThreadingHTTPServer(("127.0.0.1", 0), handler_of(server))
    server.url = f"http://127.0.0.1:{http.server_address[1]}"
    thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        http.shutdown()
        http.server_close()
        thread.join()


def archive_of(*members: tuple[tarfile.TarInfo, bytes]) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz") as tar:
        for info, data in members:
            info.size = len(data) if info.isreg() else 0
            tar.addfile(info, io.BytesIO(data))
    return out.getvalue()


def plain(name: str, data: bytes = b"x") -> tuple[tarfile.TarInfo, bytes]:
    return tarfile.TarInfo(name), data


def special(name: str, kind: bytes, link: str = "") -> tuple[tarfile.TarInfo, bytes]:
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, link
    return info, b""


def test_a_dropped_connection_is_resumed_where_it_broke(tmp_path: Path) -> None:
    with serving(files={"/a": NOISE}, drop_after=150_000, drops=2) as server:
        fetch(f"{server.url}/a", tmp_path / "a", wait_s=0.0)
    assert (tmp_path / "a").read_bytes() == NOISE
    assert [wanted for _, wanted in server.asked] == [None, "bytes=150000-", "bytes=300000-"]
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_second_call_goes_on_where_the_first_was_given_up(tmp_path: Path) -> None:
    with serving(files={"/a": NOISE}, drop_after=150_000, drops=1) as server:
        with pytest.raises(IdRgbdoError, match="call again to go on"):
            fetch(f"{server.url}/a", tmp_path / "a", tries=1, wait_s=0.0, on_bytes=fail_later(server))
        assert (tmp_path / "a.part").stat().st_size == 150_000
        fetch(f"{server.url}/a", tmp_path / "a", wait_s=0.0)
    assert (tmp_path / "a").read_bytes() == NOISE
    assert server.asked[-1][1] == "bytes=150000-"


def fail_later(server: Server) -> Callable[[int, int | None], None]:
    """After the first bytes, the server only answers 503."""

    def on_bytes(done: int, total: int | None) -> None:
        if done and not server.statuses:
            server.statuses = [503]

    return on_bytes


@pytest.mark.parametrize("options", [{"ranges": False}, {"etag": None}, {"etag": 'W/"1"'}])
def test_a_server_that_cannot_resume_is_asked_anew(tmp_path: Path, options: dict[str, Any]) -> None:
    with serving(files={"/a": NOISE}, drop_after=150_000, drops=1, **options) as server:
        fetch(f"{server.url}/a", tmp_path / "a", wait_s=0.0)
    assert (tmp_path / "a").read_bytes() == NOISE


def test_a_file_that_changed_meanwhile_is_not_glued_together(tmp_path: Path) -> None:
    other = NOISE[::-1]
    with serving(files={"/a": NOISE}, drop_after=100_000, drops=1) as server:

        def on_bytes(done: int, total: int | None) -> None:
            if done:
                server.files, server.etag = {"/a": other}, '"2"'

        fetch(f"{server.url}/a", tmp_path / "a", wait_s=0.0, on_bytes=on_bytes)
    assert (tmp_path / "a").read_bytes() == other


def test_a_chunked_answer_that_breaks_off_is_not_taken_for_whole(tmp_path: Path) -> None:
    with serving(files={"/a": NOISE}, drop_after=100_000, drops=1, chunked=True, ranges=False) as server:
        fetch(f"{server.url}/a", tmp_path / "a", wait_s=0.0)
    assert (tmp_path / "a").read_bytes() == NOISE
    assert len(server.asked) == 2


def test_a_server_error_is_repeated_and_a_missing_file_is_not(tmp_path: Path) -> None:
    with serving(files={"/a": NOISE}) as server:
        server.statuses = [503, 500]
        fetch(f"{server.url}/a", tmp_path / "a", wait_s=0.0)
        assert len(server.asked) == 3
        with pytest.raises(IdRgbdoError, match="404"):
            fetch(f"{server.url}/b", tmp_path / "b", wait_s=0.0)
        assert len(server.asked) == 4
    with pytest.raises(IdRgbdoError, match="failed 2 times"):
        fetch(f"{server.url}/a", tmp_path / "c", tries=2, wait_s=0.0)


def test_a_checksum_is_recorded_once_and_checked_ever_after(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(NOISE)
    found = check_sum(tmp_path / "a", tmp_path / "SHA256SUMS")
    assert found == hashlib.sha256(NOISE).hexdigest()
    assert (tmp_path / "SHA256SUMS").read_text() == f"{found}  a\n"
    assert check_sum(tmp_path / "a", tmp_path / "SHA256SUMS") == found
    (tmp_path / "a").write_bytes(NOISE[:-1])
    with pytest.raises(IdRgbdoError, match="SHA-256"):
        check_sum(tmp_path / "a", tmp_path / "SHA256SUMS")


HOSTILE = {
    "up": [plain("seq/../../evil")],
    "absolute": [plain("/tmp/evil_of_the_archive_test")],
    "drive": [plain("C:/evil")],
    "backslash": [plain("seq\\..\\..\\evil")],
    "symlink out": [special("seq/out", tarfile.SYMTYPE, "/"), plain("seq/out/evil")],
    "symlink inside": [plain("seq/a"), special("seq/b", tarfile.SYMTYPE, "a")],
    "hard link": [special("seq/passwd", tarfile.LNKTYPE, "/etc/passwd")],
    "device": [special("seq/null", tarfile.CHRTYPE)],
    "pipe": [special("seq/pipe", tarfile.FIFOTYPE)],
    "overwrite": [plain("seq/a"), plain("seq/a", b"y")],
    "two tops": [plain("seq/a"), plain("other/a")],
    "file at the top": [plain("evil")],
    "nothing": [],
}


@pytest.mark.parametrize("members", HOSTILE.values(), ids=HOSTILE)
def test_a_hostile_archive_leaves_nothing_behind(tmp_path: Path, members: list[tuple[tarfile.TarInfo, bytes]]) -> None:
    (tmp_path / "a.tgz").write_bytes(archive_of(*members))
    (tmp_path / "in").mkdir()
    with pytest.raises(IdRgbdoError, match="archive"):
        extract(tmp_path / "a.tgz", tmp_path / "in" / "seq")
    assert list((tmp_path / "in").iterdir()) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.tgz", "in"]
    assert not Path("/tmp/evil_of_the_archive_test").exists()


def test_bombs_are_refused(tmp_path: Path) -> None:
    (tmp_path / "big.tgz").write_bytes(archive_of(plain("seq/zeros", bytes(20_000_000))))
    assert (tmp_path / "big.tgz").stat().st_size < 100_000
    with pytest.raises(IdRgbdoError, match="more than"):
        extract(tmp_path / "big.tgz", tmp_path / "seq", most_bytes=10_000_000)
    (tmp_path / "many.tgz").write_bytes(archive_of(*(plain(f"seq/{k}") for k in range(50))))
    with pytest.raises(IdRgbdoError, match="more than"):
        extract(tmp_path / "many.tgz", tmp_path / "seq", most_files=20)
    # a header that claims to be huge would be read into memory at once
    header = tarfile.TarInfo("seq/long")
    header.type, header.size = tarfile.XHDTYPE, 30_000_000
    bomb = gzip.compress(header.tobuf(tarfile.USTAR_FORMAT) + bytes(30_000_256))
    (tmp_path / "header.tgz").write_bytes(bomb)
    with pytest.raises(IdRgbdoError, match="at once"):
        extract(tmp_path / "header.tgz", tmp_path / "seq")
    assert not (tmp_path / "seq").exists()


def test_a_damaged_archive_is_said_to_be_one(tmp_path: Path) -> None:
    whole = archive_of(plain("seq/rgb.txt", NOISE))
    for name, data in {"cut": whole[: len(whole) // 2], "text": b"<html>not here</html>"}.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(IdRgbdoError, match="damaged"):
            extract(tmp_path / name, tmp_path / "seq")
        assert not (tmp_path / "seq").exists()


def test_the_command_fetches_unpacks_and_does_nothing_twice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    full = "rgbd_dataset_freiburg1_desk"
    archive = archive_of(plain(f"{full}/rgb.txt", b"# images\n"), plain(f"{full}/rgb/1.png", NOISE))
    with serving(files={f"/freiburg1/{full}.tgz": archive}, drop_after=100_000, drops=1) as server:
        call = ["download", "tum", "fr1_desk", "--out", str(tmp_path), "--url", server.url]
        assert main(call) == 0
        assert (tmp_path / full / "rgb" / "1.png").read_bytes() == NOISE
        assert sorted(path.name for path in tmp_path.iterdir()) == ["SHA256SUMS", full]
        asked = len(server.asked)
        assert main(call) == 0
        assert len(server.asked) == asked
    capsys.readouterr()
    assert main(["download", "tum", "--out", str(tmp_path)]) == 1
    assert main(["download", "tum", "freiburg1_desks"]) == 1
    errors = capsys.readouterr().err
    assert "expected sequences or --all" in errors and "did you mean 'freiburg1_desk'?" in errors


def test_an_archive_that_differs_from_the_first_one_is_not_unpacked(tmp_path: Path) -> None:
    full = "rgbd_dataset_freiburg1_xyz"
    (tmp_path / "SHA256SUMS").write_text(f"{'0' * 64}  {full}.tgz\n")
    archive = archive_of(plain(f"{full}/rgb.txt"))
    with serving(files={f"/freiburg1/{full}.tgz": archive}) as server, pytest.raises(IdRgbdoError, match="SHA-256"):
        download_tum(["freiburg1_xyz"], tmp_path, url=server.url)
    assert not (tmp_path / full).exists()


def test_names() -> None:
    assert len(set(TUM_SEQUENCES)) == 18
    assert {long_name(f"rgbd_dataset_{name}") for name in TUM_SEQUENCES} == set(TUM_SEQUENCES)
    assert long_name("fr3_cabinet") == "freiburg3_cabinet"
