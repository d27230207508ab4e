"""Real-time dead reckoning for wheeled robots: gyro and wheel encoders in, pose with its uncertainty out."""

__version__ = "0.1.0"
