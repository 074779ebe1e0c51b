"""The removal rule's fused twin against its torch definition."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from plane_scene import close

from idrgbdo_torch.definitions import removal as definition
from idrgbdo_torch.definitions import se3
from idrgbdo_torch.kernels import removal


@pytest.mark.parametrize("K", [3, 9])
def test_it_is_the_definition(K: int) -> None:
    rng = np.random.default_rng(K)
    units = np.tile([1e4, 1e4, 1e4, 3e3, 3e3, 3e3], K)
    J = rng.standard_normal((40 * K, 6 * K)) * units
    A = rng.standard_normal((K, 20, 6)) * units[:6]
    links = A.transpose(0, 2, 1) @ A
    links[0] = 0.0  # a keyframe that the view does not see
    poses = se3.exp(0.2 * torch.from_numpy(rng.standard_normal((K, 6))))
    adjoints = se3.adjoint(poses).numpy()
    arguments = (J.T @ J, links, adjoints)
    copies = [x.copy() for x in arguments]
    bits = removal.next_view_bits(*arguments)
    close(bits, definition.next_view_bits(*map(torch.from_numpy, arguments)), 1e-6)
    assert bits.argmin() == 0 and bits[1:].min() > 1e-3
    assert all(np.array_equal(x, y) for x, y in zip(arguments, copies, strict=True))
    assert np.isnan(removal.next_view_bits(-arguments[0], links, adjoints)).all()
