"""The null baseline: what a method gets that never looks at an image."""

from __future__ import annotations

from idrgbdo_torch.odometry import ConstantVelocity


def make() -> ConstantVelocity:
    """A camera that stays where it is."""
    return ConstantVelocity()
