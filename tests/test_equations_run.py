"""The definitions run: with backend "torch" and the paper's settings a short run calls the home of every equation."""

from __future__ import annotations

from dataclasses import replace

from equations import ROOT, TAGS, called, code_of, homes
from rendered import SMALL, film

from idrgbdo_torch import IdRgbdo, Status, run
from idrgbdo_torch.config import Config
from idrgbdo_torch.text import configfile

FRAMES = 16
TINY = replace(SMALL, frames=FRAMES, width=160, height=120, fx=131.25, fy=131.25, cx=79.5, cy=59.5, samples=1)


def test_a_short_run_calls_the_home_of_every_equation_and_of_algorithm_1() -> None:
    paper = configfile.load(ROOT / "configs" / "paper.toml", Config())
    config = replace(paper, backend="torch", window=replace(paper.window, keyframes=3))
    frames = film(TINY).frames
    odometry = IdRgbdo(config)
    with called() as codes:
        done = run(odometry, frames)
    made = sum(record.result.keyframe for record in done.records)
    left = len(odometry.window.members.keyframes)
    assert left == config.window.keyframes < made, f"{made} keyframes, {left} in the window: none was marginalised"
    assert Status.LOST not in done.statuses
    idle = {tag: home for tag in TAGS for home in homes(tag) if code_of(home) not in codes}
    assert not idle, f"never called: {idle}"
