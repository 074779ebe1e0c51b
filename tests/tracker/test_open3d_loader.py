"""Open3D is found even where libusb is not installed, and only when asked for."""

from __future__ import annotations

import subprocess
import sys

from idrgbdo_torch.tracker.open3d_loader import load_open3d


def test_open3d_loads_and_is_loaded_once() -> None:
    o3d = load_open3d()
    assert o3d.core.Tensor([1.0, 2.0]).numpy().tolist() == [1.0, 2.0]
    assert load_open3d() is o3d


def test_names_of_the_rendered_world_import_without_torch_and_open3d() -> None:
    code = (
        "import sys; import idrgbdo_torch.tracker.open3d_loader\n"
        "from idrgbdo_torch.synthetic import SynthConfig, synth; "
        "SynthConfig(); print([m for m in ('torch', 'open3d', 'numba', 'cv2') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
