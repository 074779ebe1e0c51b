"""The one place that imports Open3D: late, as it takes seconds, and with libusb at hand, because it links to it."""

from __future__ import annotations

import ctypes
import importlib
import sys
from functools import cache
from types import ModuleType

from ..errors import IdRgbdoError


@cache
def load_open3d() -> ModuleType:
    """The module open3d, imported on the first call.

    On Linux Open3D links to libusb-1.0, which many servers lack; libusb-package carries it, and once its library is
    loaded with global symbols the linker accepts it for Open3D's.
    Raises IdRgbdoError when Open3D cannot be imported.
    """
    load_libusb()
    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as error:
        raise IdRgbdoError(
            f"open3d: expected an importable Open3D >= 0.19, got '{error}'; run `pip install open3d libusb-package`"
        ) from error


def load_libusb() -> None:
    """On Linux, load the packaged libusb-1.0 globally; without the package the system's own library has to do."""
    if sys.platform != "linux":
        return
    try:
        import libusb_package
    except ImportError:
        return
    path = libusb_package.get_library_path()
    if path is not None:
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
