"""`make honesty`: test the estimator's promises on every drive with a reference, against simpler estimators."""
