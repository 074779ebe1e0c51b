"""The sequences of the TUM RGB-D benchmark that the paper's Table 1 lists."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import IdRgbdoError
from .extract import extract
from .fetch import WAIT_S, check_sum, fetch

BASE_URL = "https://cvg.cit.tum.de/rgbd/dataset"
SUMS = "SHA256SUMS"
RAW_BYTES_A_SECOND = 30 * 640 * 480 * 5  # uncompressed colour and depth: no archive is larger than its images
SLACK = 1.25  # for lists, and for recordings that began before the published duration
SECONDS = {  # as published, in the order of Table 1
    "freiburg1_desk": 23.4,
    "freiburg1_floor": 49.9,
    "freiburg1_plant": 41.5,
    "freiburg1_rpy": 27.7,
    "freiburg1_xyz": 30.1,
    "freiburg2_desk": 99.4,
    "freiburg2_dishes": 100.6,
    "freiburg2_rpy": 110.0,
    "freiburg2_xyz": 122.7,
    "freiburg3_cabinet": 38.6,
    "freiburg3_large_cabinet": 34.0,
    "freiburg3_long_office_household": 87.1,
    "freiburg3_nostructure_texture_far": 15.8,
    "freiburg3_nostructure_texture_near_withloop": 56.5,
    "freiburg3_structure_notexture_far": 27.3,
    "freiburg3_structure_notexture_near": 36.4,
    "freiburg3_structure_texture_far": 31.6,
    "freiburg3_structure_texture_near": 36.9,
}
TUM_SEQUENCES = tuple(SECONDS)


@dataclass(frozen=True)
class Progress:
    """What is going on, for a progress bar."""

    name: str
    job: int  # from 1
    jobs: int
    done: int  # bytes
    total: int | None


def most_bytes(name: str) -> int:
    """That a sequence can have, packed or unpacked."""
    return round(SECONDS[name] * RAW_BYTES_A_SECOND * SLACK)


def long_name(name: str) -> str:
    """The published name of a sequence: fr1_desk, freiburg1_desk and rgbd_dataset_freiburg1_desk are the same.

    Raises IdRgbdoError for any that is not of Table 1.
    """
    plain = name.strip().removesuffix(".tgz").removeprefix("rgbd_dataset_").replace("/", "_")
    plain = plain.replace("fr", "freiburg", 1) if plain[2:3] in ("1", "2", "3") else plain
    if plain not in TUM_SEQUENCES:
        near = difflib.get_close_matches(plain, TUM_SEQUENCES, n=1, cutoff=0.5)
        hint = f"did you mean '{near[0]}'?" if near else f"the sequences are {', '.join(TUM_SEQUENCES)}"
        raise IdRgbdoError(f"names: no sequence '{name}' in Table 1; {hint}")
    return plain


def download_tum(
    names: Sequence[str],
    out: Path,
    *,
    url: str = BASE_URL,
    keep_archives: bool = False,
    wait_s: float = WAIT_S,
    on_progress: Callable[[Progress], None] = lambda progress: None,
) -> list[Path]:
    """The folders of the named sequences in `out`; what is there already is left as it is.

    The SHA-256 of each archive is recorded in out/SHA256SUMS on first use and checked ever after.
    Raises IdRgbdoError for unknown names, a download that fails, and an archive that cannot be trusted.
    """
    known = [long_name(name) for name in names]
    folders = []
    for job, name in enumerate(known, start=1):
        full = f"rgbd_dataset_{name}"
        folder, archive = out / full, out / f"{full}.tgz"
        folders.append(folder)
        if (folder / "rgb.txt").exists():
            continue
        if not archive.exists():

            def on_bytes(done: int, total: int | None, name: str = name, job: int = job) -> None:
                on_progress(Progress(name, job, len(known), done, total))

            source = f"{url.rstrip('/')}/{name.partition('_')[0]}/{full}.tgz"
            fetch(source, archive, most_bytes=most_bytes(name), wait_s=wait_s, on_bytes=on_bytes)
        check_sum(archive, out / SUMS)
        extract(archive, folder, most_bytes=most_bytes(name))
        if not (folder / "rgb.txt").exists():
            raise IdRgbdoError(
                f"archive: '{archive}' holds no rgb.txt, so it is no sequence; remove both and call again"
            )
        if not keep_archives:
            archive.unlink()
    return folders
