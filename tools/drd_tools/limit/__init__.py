"""The smallest error that any estimator can have on a drive: the posterior Cramer-Rao bound."""
