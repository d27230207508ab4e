"""`make honesty`: what the estimator promises, on every drive that has a reference, beside simpler estimators."""
