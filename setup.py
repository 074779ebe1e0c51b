"""The packages: the package, and baselines/ and configs/ as parts of it.

Presets are then known by name, and no other package called baselines stands in the way.
"""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["idrgbdo_torch*"]), "idrgbdo_torch.baselines", "idrgbdo_torch.configs"],
    package_dir={"idrgbdo_torch.baselines": "baselines", "idrgbdo_torch.configs": "configs"},
    package_data={
        "idrgbdo_torch": ["py.typed"],
        "idrgbdo_torch.report": ["web/*"],
        "idrgbdo_torch.configs": ["*.toml"],
    },
)
