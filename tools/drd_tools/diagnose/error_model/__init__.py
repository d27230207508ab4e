"""The linear model of errors around the path, and the Kalman filter that whitens data and sensitivities."""
