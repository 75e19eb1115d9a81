"""Make recorded odometry as wrong as a real robot's, and learn how wrong the real robot's is, and why."""

__version__ = "0.1.0"
