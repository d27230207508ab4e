"""Linear error model around the path, and the Kalman filter that whitens data and sensitivities."""
