"""One file over HTTP: goes on where it stopped, and is what it was the first time."""

from __future__ import annotations

import hashlib
import http.client
import json
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import IdRgbdoError

CHUNK = 1 << 20  # bytes
TIMEOUT_S = 60.0  # without a byte
WAIT_S = 2.0  # before the first repetition, then twice as long each time
PARTIAL = 206
DROPPED = (urllib.error.URLError, http.client.HTTPException, ConnectionError, TimeoutError)
GIVE_UP = range(400, 500)  # the request itself is wrong: repeating it is no use

OnBytes = Callable[[int, int | None], None]  # bytes so far, bytes in all where the server says


def fetch(
    url: str, target: Path, *, tries: int = 6, wait_s: float = WAIT_S, on_bytes: OnBytes = lambda done, total: None
) -> None:
    """Download url to the file target, by way of target.part.

    A dropped connection, in this call or an earlier one, is resumed by a Range request, unless the file on the server
    has changed since (ETag or Last-Modified) or the server cannot resume: then it begins anew. `tries` failures in a
    row without a byte between them end it. Raises IdRgbdoError where the file cannot be had.
    """
    part, note = target.with_name(target.name + ".part"), target.with_name(target.name + ".part.json")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        failures = 0
        while failures < tries:
            before = part.stat().st_size if part.exists() else 0
            try:
                if _receive(url, part, note, on_bytes):
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


def _receive(url: str, part: Path, note: Path, on_bytes: OnBytes) -> bool:
    """Append what the server sends to `part`; whether that is all of it."""
    known = _read_note(note)
    have = part.stat().st_size if part.exists() and known.get("version") else 0
    headers = {"User-Agent": "idrgbdo", "Accept-Encoding": "identity"}
    if have:
        headers |= {"Range": f"bytes={have}-", "If-Range": known["version"]}
    with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=TIMEOUT_S) as response:
        resumed = response.status == PARTIAL
        start, total = _range_of(response) if resumed else (0, _length_of(response))
        if start != have and resumed:
            raise http.client.HTTPException(f"asked for bytes from {have} on, got them from {start} on")
        tag = response.headers.get("ETag", "")
        version = tag if tag.startswith('"') else response.headers.get("Last-Modified", "")  # a weak tag won't do
        note.write_text(json.dumps({"version": version}), encoding="utf-8")
        done = have if resumed else 0
        with part.open("ab" if resumed else "wb") as file:
            on_bytes(done, total)
            while chunk := response.read1(CHUNK):  # a drop raises here, what came before is in the file
                file.write(chunk)
                done += len(chunk)
                on_bytes(done, total)
    return total is None or done == total


def _length_of(response: Any) -> int | None:
    length = response.headers.get("Content-Length", "")
    return int(length) if length.isdecimal() else None


def _range_of(response: Any) -> tuple[int, int | None]:
    """First byte, and size of the whole file, of a partial answer."""
    match = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
    if match is None:
        raise http.client.HTTPException("a partial answer without a valid Content-Range")
    return int(match[1]), None if match[2] == "*" else int(match[2])


def _read_note(note: Path) -> dict[str, str]:
    try:
        known = json.loads(note.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return known if isinstance(known, dict) else {}


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_sum(path: Path, sums: Path) -> str:
    """The file's SHA-256, compared with the line of that name in `sums` (`sum  name`, as sha256sum writes them).

    A file without a line gets one: what came the first time is what must come later. Raises IdRgbdoError where they
    differ.
    """
    found = sha256_of(path)
    lines = sums.read_text(encoding="utf-8").splitlines() if sums.exists() else []
    recorded = {name.lstrip("*"): value for value, _, name in (line.partition("  ") for line in lines)}
    if path.name not in recorded:
        sums.write_text("\n".join([*lines, f"{found}  {path.name}"]) + "\n", encoding="utf-8")
    elif recorded[path.name] != found:
        raise IdRgbdoError(
            f"download: {path.name} has SHA-256 {found[:12]}..., but '{sums}' recorded {recorded[path.name][:12]}...; "
            f"if the file was meant to change, remove its line there"
        )
    return found
