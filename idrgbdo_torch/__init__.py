"""Information-driven direct RGB-D odometry on Open3D and PyTorch."""

__version__ = "0.1.0"
