"""Analytic sky models: closed formulas, no simulation."""
