"""Fits of the analytic models: distribution over the dome, and values at the zenith."""
