"""The method of this package, as the comparison runs it."""

from __future__ import annotations

from dataclasses import replace

from idrgbdo_torch.config import Config, Mode
from idrgbdo_torch.text import configfile
from idrgbdo_torch.tracker.id_rgbdo import IdRgbdo


def configuration(points: int, mode: Mode, seed: int = 0) -> Config:
    """The defaults with another number of points, another selection and another seed."""
    config = Config()
    selection = replace(config.selection, points=points, mode=mode)
    window = replace(config.window, points=points)
    return replace(config, selection=selection, window=window, seed=seed)


def settings(points: int, mode: Mode) -> str:
    """The whole configuration as TOML, whatever the seed."""
    return configfile.dump(configuration(points, mode))


def make(points: int, mode: Mode, seed: int) -> IdRgbdo:
    """Information-driven RGB-D odometry."""
    return IdRgbdo(configuration(points, mode, seed))
