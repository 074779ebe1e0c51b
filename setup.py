"""The packages: all that is found, and configs/ as a part of the package, so that presets are known by name."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["idrgbdo_torch*", "baselines*"]), "idrgbdo_torch.configs"],
    package_dir={"idrgbdo_torch.configs": "configs"},
    package_data={
        "idrgbdo_torch": ["py.typed"],
        "idrgbdo_torch.report": ["web/*"],
        "idrgbdo_torch.configs": ["*.toml"],
    },
)
