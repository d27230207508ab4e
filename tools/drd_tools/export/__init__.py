"""A recording's poses in the forms of others: ROS 2 bag, CSV, TUM trajectory, Parquet."""
