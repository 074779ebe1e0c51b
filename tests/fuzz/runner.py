"""Runs the attacks of seeds, one after the other; a new kind of attack is a function and a line of ATTACKS."""

from __future__ import annotations

import argparse
import traceback
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from . import checkpoints, doors, downloads, folders, frames, kills, readers, stress, structures
from .promise import Attack, limits

ATTACKS: Mapping[str, Attack] = {
    "spoiled checkpoint": Attack(checkpoints.spoiled_checkpoint, ready=checkpoints.whole),
    "sealed checkpoint": Attack(checkpoints.sealed_checkpoint, ready=checkpoints.whole),
    "full disk": Attack(folders.full_disk),
    "edited note": Attack(folders.edited_note),
    "edited results": Attack(folders.edited_results),
    "names": Attack(folders.names),
    "answers": Attack(downloads.answers),
    "archives": Attack(downloads.archives),
    "one image": Attack(readers.one_image, ready=readers.ready),
    "one text": Attack(readers.one_text, ready=readers.ready),
    "strange folder": Attack(readers.strange_folder, ready=readers.ready),
    "bags": Attack(readers.bags, ready=readers.ready),
    "inner places": Attack(structures.inner, ready=readers.ready),
    "bombs": Attack(
        structures.bomb, every=10, most_s=60, ready=readers.ready
    ),  # most of it makes them; reading has 10 s
    "camera files": Attack(readers.camera_files),
    "settings": Attack(readers.settings),
    "poses": Attack(readers.poses),
    "run tables": Attack(readers.run_tables),
    "hostile frames": Attack(frames.hostile_frames, most_s=60, ready=frames.undisturbed),
    "hostile poses": Attack(frames.hostile_poses, most_s=60, ready=frames.undisturbed),
    "doors": Attack(doors.doors, most_s=60, ready=doors.calls),
    "files": Attack(doors.files),
    "killed": Attack(kills.killed, every=10, most_s=600),
}


def attack(seed: int, attacks: Mapping[str, Attack] = ATTACKS) -> tuple[str, str]:
    """The name of the seed's attack, empty where it is left out; and what broke, empty where nothing did."""
    turn, place = divmod(seed, len(attacks))
    name = list(attacks)[place]
    if turn % attacks[name].every:
        return "", ""
    attacks[name].ready()
    with TemporaryDirectory() as folder:
        try:
            with limits(attacks[name].most_s):
                attacks[name].run(np.random.default_rng(seed), Path(folder))
        except BaseException as error:  # whatever it is, it is the finding
            if isinstance(error, KeyboardInterrupt):
                raise
            return name, traceback.format_exc()
    return name, ""


def run(seeds: Iterable[int], attacks: Mapping[str, Attack] = ATTACKS) -> int:
    """Run the attacks of all seeds, print what broke with the seed that repeats it, and how many were made."""
    made: Counter[str] = Counter()
    broken: Counter[str] = Counter()
    with suppress(KeyboardInterrupt):  # what was made until then counts
        for seed in seeds:
            name, trouble = attack(seed, attacks)
            made[name] += bool(name)
            if trouble:
                broken[name] += 1
                print(f"seed {seed}, {name}: python -m tests.fuzz --seeds {seed}:{seed + 1}\n{trouble}", flush=True)
    for name in attacks:
        print(f"{name:<20}{made[name]:>7} made{broken[name]:>6} broken")
    return 1 if broken else 0


def main(arguments: list[str]) -> int:
    """The exit status: 1 where anything broke."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seeds", default="0:1000", help="first:last+1")
    parser.add_argument("--only", default="", help="names of attacks, with commas between")
    parser.add_argument("--stress", action="store_true", help="statuses under stress, a rendered film a seed")
    parser.add_argument("--films", type=Path, nargs="+", default=[], help="recordings with poses to stress instead")
    options = parser.parse_args(arguments)
    first, last = (int(text) for text in options.seeds.split(":"))
    seeds: Iterable[int] = range(first, last)
    if options.stress or options.films:
        return stress.run(first, last, options.films, options.only)
    if options.only:
        wanted = {list(ATTACKS).index(name.strip()) for name in options.only.split(",")}
        seeds = (seed for seed in seeds if seed % len(ATTACKS) in wanted)
    return run(seeds)
