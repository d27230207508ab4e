"""Smallest error that any estimator can achieve on a drive: the posterior Cramer-Rao bound."""
