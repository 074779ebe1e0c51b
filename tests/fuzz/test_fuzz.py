"""The first seeds of every attack that needs no process of its own; the night runs the others."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz.promise import Attack
from fuzz.runner import ATTACKS, attack, run
from numpy.random import Generator

SEEDS = 50 * len(ATTACKS)  # those that would kill processes are left out
QUICK = [name for name in ATTACKS if ATTACKS[name].every == 1]


@pytest.mark.parametrize("name", QUICK)
def test_no_seed_breaks_a_promise(name: str) -> None:
    place = list(ATTACKS).index(name)
    for seed in range(place, SEEDS, len(ATTACKS)):
        assert attack(seed) == (name, "")


def hangs(rng: Generator, folder: Path) -> None:
    while True:
        pass


def raises(rng: Generator, folder: Path) -> None:
    raise ValueError(f"of {rng.integers(1000)}")


def test_what_breaks_is_printed_with_its_seed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(range(4, 6), {"raises": Attack(raises), "hangs": Attack(hangs, most_s=1)}) == 1
    first = capsys.readouterr().out
    assert "--seeds 4:5" in first and "ValueError: of" in first
    assert "--seeds 5:6" in first and "TimeoutError" in first
    assert run([4], {"raises": Attack(raises), "hangs": Attack(hangs)}) == 1
    again = capsys.readouterr().out
    assert next(line for line in again.splitlines() if line.startswith("ValueError")) in first
