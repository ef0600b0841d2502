"""Measurements of speed, in a checkout: ``python -m benchmarks.speed``; docs/performance.md explains them."""
