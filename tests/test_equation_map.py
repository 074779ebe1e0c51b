"""Every equation has one home, and the README's map leads to it and to what runs by default in its place."""

from __future__ import annotations

from re import fullmatch

import pytest
from equations import PACKAGE, TAGS, called, code_of, homes, label, rows
from rendered import Film

from idrgbdo_torch import IdRgbdo

ITSELF = "-"  # in the column of twins: the definition runs by default too


def twin(tag: str) -> str:
    """The last cell of a tag's row: `file.py:function`, or ITSELF."""
    cell = rows()[label(tag)][-1]
    if cell == ITSELF:
        return ITSELF
    found = fullmatch(r"\[(\S+\.py)\]\(idrgbdo_torch/(\S+\.py)\): `?(\w+)`?", cell)
    assert found is not None, f"the row of {tag} names no twin: {cell}"
    assert found[1] == found[2], f"the link of {tag}'s twin leads elsewhere: {cell}"
    return f"{found[1]}:{found[3]}"


@pytest.mark.parametrize("tag", TAGS)
def test_one_home_and_one_row(tag: str) -> None:
    found = homes(tag)
    assert len(found) == 1, f"{tag} opens {len(found)} docstrings: {found}"
    file, name = found[0].split(":")
    assert label(tag) in rows(), f"the README's equation map has no row for {tag}"
    _, home, _ = rows()[label(tag)]
    assert home == f"[{file}](idrgbdo_torch/{file}): `{name}", f"the row of {tag} does not name {found[0]}: {home}"


@pytest.mark.parametrize("tag", TAGS)
def test_the_twin_is_there(tag: str) -> None:
    if twin(tag) != ITSELF:
        file, name = twin(tag).split(":")
        assert file.startswith(("kernels/", "tracker/")), f"{file} is no place of what runs by default"
        assert code_of(twin(tag)).co_name == name and twin(tag) not in homes(tag)


def test_a_definition_without_a_twin_runs_by_default(desk: Film) -> None:
    odometry = IdRgbdo()
    with called() as codes:
        for frame in desk.frames[:12]:
            odometry.track(frame)
    alone = {tag: homes(tag)[0] for tag in TAGS if twin(tag) == ITSELF}
    idle = {tag: home for tag, home in alone.items() if code_of(home) not in codes}
    assert alone and not idle, f"neither runs by default nor has a twin: {idle}"
    replaced = {tag: homes(tag)[0] for tag in TAGS if twin(tag) != ITSELF and code_of(homes(tag)[0]) in codes}
    assert not replaced, f"runs by default beside its twin: {replaced}"


def test_kernels_stand_file_for_file_beside_their_definitions() -> None:
    kernels, definitions = (
        {path.stem for path in (PACKAGE / side).glob("*.py")} for side in ("kernels", "definitions")
    )
    # what linearise and window share; images and matches, whose oracle is OpenCV; sights and surfaces, no equations
    assert kernels - definitions == {"compiled", "patch", "equations", "pyramid", "matching", "sights", "surface"}
