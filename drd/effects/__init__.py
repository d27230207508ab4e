"""Physical effects, one module each: one formula for simulator, compensation and diagnosis."""
