"""One file over HTTP: goes on where it stopped, and is what it was the first time."""

from __future__ import annotations

import hashlib
import http
import http.client
import io
import json
import os
import queue
import re
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import IdRgbdoError
from ..text.files import MOST_SETTINGS, MOST_TEXT, open_plain, plain_bytes, plain_descriptor

CHUNK = 1 << 20  # bytes
TIMEOUT_S = 60.0  # without a byte
WAIT_S = 2.0  # before the first repetition, then twice as long each time
PARTIAL = 206
DROPPED = (urllib.error.URLError, http.client.HTTPException, ConnectionError, TimeoutError, UnicodeError)


class Redirections(urllib.request.HTTPRedirectHandler):
    """Follows them without the page that comes with one, which may have no end."""

    def http_error_302(self, req: Any, fp: Any, code: int, msg: str, headers: Any) -> Any:
        """Of the server's answer fp only the head counts."""
        fp.close()
        return super().http_error_302(req, io.BytesIO(), code, msg, headers)

    http_error_301 = http_error_303 = http_error_307 = http_error_308 = http_error_302


HTTP_ONLY = (
    urllib.request.ProxyHandler,
    urllib.request.UnknownHandler,
    urllib.request.HTTPHandler,
    urllib.request.HTTPSHandler,
    urllib.request.HTTPDefaultErrorHandler,
    Redirections,
    urllib.request.HTTPErrorProcessor,
)  # no file:, ftp: or data:, not even behind a redirection
GIVE_UP = range(400, 500)  # the request itself is wrong: repeating it is no use
OPEN_S = 120.0  # until the server's answer begins, redirections included
SLOW_S = 60.0  # over which the speed is measured
SLOWEST = 1000.0  # bytes a second; a server that is slower will not get done
MOST_DIGITS = 15  # of a length that is believed

OnBytes = Callable[[int, int | None], None]  # bytes so far, bytes in all where the server says


def fetch(
    url: str,
    target: Path,
    *,
    most_bytes: int | None = None,
    tries: int = 6,
    wait_s: float = WAIT_S,
    on_bytes: OnBytes = lambda done, total: None,
) -> None:
    """Download url to the file target, by way of target.part.

    A dropped connection, in this call or an earlier one, is resumed by a Range request, unless the file on the server
    has changed since (ETag or Last-Modified) or the server cannot resume: then it begins anew. `tries` failures in a
    row without a byte between them end it. Raises IdRgbdoError where the file cannot be had, comes at less than 1 kB/s,
    or is larger than most_bytes.
    """
    check_url(url)
    part, note = target.with_name(target.name + ".part"), target.with_name(target.name + ".part.json")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        failures = 0
        while failures < tries:
            before = part.stat().st_size if part.exists() else 0
            try:
                if _receive(url, part, note, most_bytes, on_bytes):
                    part.replace(target)
                    note.unlink(missing_ok=True)
                    return
                problem = "the connection was dropped"
            except urllib.error.HTTPError as error:
                if error.code == http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE and before:
                    part.unlink()  # more than the server has: it is another file
                elif error.code in GIVE_UP:
                    raise IdRgbdoError(f"download: '{url}' answers {error.code} {error.reason}; check --url") from error
                problem = f"{error.code} {error.reason}"
            except DROPPED as error:
                problem = str(error) or type(error).__name__
            advanced = part.exists() and part.stat().st_size > before
            failures = 0 if advanced else failures + 1
            if failures < tries:
                time.sleep(wait_s * 2 ** max(failures - 1, 0) if failures else 0.0)
    except OSError as error:
        raise IdRgbdoError(f"download: cannot write '{part}': {error}; pass another --out") from error
    raise IdRgbdoError(f"download: '{url}' failed {tries} times in a row ({problem}); call again to go on from there")


def check_url(url: str) -> None:
    """Raises IdRgbdoError for what is no http or https address."""
    try:
        parts = urllib.parse.urlsplit(url)
        good = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0 and url.isascii()
        good = good and url.isprintable() and " " not in url
    except ValueError:
        good = False
    if not good:
        raise IdRgbdoError(f"url: expected an address such as https://server/folder, got '{url}'; correct --url")


def _receive(url: str, part: Path, note: Path, most_bytes: int | None, on_bytes: OnBytes) -> bool:
    """Append what the server sends to `part`; whether that is all of it."""
    known = _read_note(note)
    have = part.stat().st_size if part.exists() and known else 0
    headers = {"User-Agent": "idrgbdo", "Accept-Encoding": "identity"}
    if have:
        headers |= {"Range": f"bytes={have}-", "If-Range": known}
    with _opened(urllib.request.Request(url, headers=headers)) as response:
        resumed = response.status == PARTIAL
        start, total = _range_of(response) if resumed else (0, _length_of(response))
        if start != have and resumed:
            raise http.client.HTTPException(f"asked for bytes from {have} on, got them from {start} on")
        _check_size(url, total or 0, most_bytes, part)
        tag = response.headers.get("ETag", "")
        version = tag if tag.startswith('"') else response.headers.get("Last-Modified", "")  # a weak tag won't do
        note.unlink(missing_ok=True)  # what has that name may be a pipe
        note.write_text(json.dumps({"version": version}), encoding="utf-8")
        done = have if resumed else 0
        begin, before = time.monotonic(), done
        flags = os.O_WRONLY | os.O_CREAT | (os.O_APPEND if resumed else os.O_TRUNC)
        with os.fdopen(plain_descriptor(part, flags), "ab" if resumed else "wb") as file:
            on_bytes(done, total)
            while chunk := _read_some(response):  # a drop raises here, what came before is in the file
                file.write(chunk)
                done += len(chunk)
                _check_size(url, done, most_bytes, part)
                on_bytes(done, total)
                if (elapsed := time.monotonic() - begin) > SLOW_S:
                    if done - before < SLOWEST * elapsed:
                        raise IdRgbdoError(
                            f"download: '{url}' comes at less than {SLOWEST:.0f} bytes a second; "
                            "call again later to go on from there"
                        )
                    begin, before = time.monotonic(), done
    return total is None or done == total


def _check_size(url: str, size: int, most: int | None, part: Path) -> None:
    if most is not None and size > most:
        part.unlink(missing_ok=True)
        raise IdRgbdoError(f"download: '{url}' is larger than the {most} bytes that this file can have; check --url")


def _read_some(response: Any) -> bytes:
    try:
        data: bytes = response.read1(CHUNK)
    except OSError as error:  # of the network; those of the disk mean something else
        raise ConnectionError(str(error) or type(error).__name__) from error
    return data


def _opened(request: urllib.request.Request) -> Any:
    """The server's answer, its head complete. In a thread, since each byte of a head may take as long as TIMEOUT_S."""
    answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
    opener = urllib.request.OpenerDirector()
    for handler in HTTP_ONLY:
        opener.add_handler(handler())

    def ask() -> None:
        try:
            answers.put(opener.open(request, timeout=TIMEOUT_S))
        except (OSError, http.client.HTTPException, ValueError, ArithmeticError) as error:
            answers.put(error)

    threading.Thread(target=ask, daemon=True).start()
    try:
        answer = answers.get(timeout=OPEN_S)
    except queue.Empty:
        raise TimeoutError(f"no answer in {OPEN_S:.0f} s") from None
    if isinstance(answer, urllib.error.HTTPError | http.client.HTTPException | TimeoutError):
        raise answer
    if isinstance(answer, OSError | ValueError | ArithmeticError):  # a redirection to nonsense among them
        raise ConnectionError(str(answer) or type(answer).__name__) from answer
    return answer


def _length_of(response: Any) -> int | None:
    length = response.headers.get("Content-Length", "")
    return int(length) if length.isdecimal() and len(length) <= MOST_DIGITS else None


def _range_of(response: Any) -> tuple[int, int | None]:
    """First byte, and size of the whole file, of a partial answer."""
    match = re.fullmatch(r"bytes (\d{1,15})-\d+/(\d{1,15}|\*)", response.headers.get("Content-Range", ""))
    if match is None:
        raise http.client.HTTPException("a partial answer without a valid Content-Range")
    return int(match[1]), None if match[2] == "*" else int(match[2])


def _read_note(note: Path) -> str:
    """The version of the file that is there in part; empty where that is not known."""
    try:
        known = json.loads(plain_bytes(note, MOST_SETTINGS))
        version = known["version"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""
    return version if isinstance(version, str) and version.isascii() and version.isprintable() else ""


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal."""
    with open_plain(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_sum(path: Path, sums: Path) -> str:
    """The file's SHA-256, compared with the line of that name in `sums` (`sum  name`, as sha256sum writes them).

    A file without a line gets one: what came the first time is what must come later. Raises IdRgbdoError where they
    differ.
    """
    try:
        found = sha256_of(path)
        text = plain_bytes(sums, MOST_TEXT).decode("utf-8", "surrogateescape") if sums.exists() else ""
        lines = text.splitlines()
    except OSError as error:
        raise IdRgbdoError(f"download: cannot read '{error.filename}': {error.strerror}; remove it") from error
    recorded = {name.lstrip("*"): value for value, _, name in (line.partition("  ") for line in lines)}
    if path.name not in recorded:
        text = "\n".join([*lines, f"{found}  {path.name}"]) + "\n"
        try:
            sums.write_text(text, encoding="utf-8", errors="surrogateescape")
        except OSError as error:
            raise IdRgbdoError(f"download: cannot write '{sums}': {error.strerror}; pass another --out") from error
    elif recorded[path.name] != found:
        raise IdRgbdoError(
            f"download: {path.name} has SHA-256 {found[:12]}..., but '{sums}' recorded {recorded[path.name][:12]}...; "
            f"if the file was meant to change, remove its line there"
        )
    return found
