"""Export of a recording's poses to other formats: ROS 2 bag, CSV, TUM trajectory, Parquet."""
