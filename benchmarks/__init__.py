"""How fast is it, and against whom? ``python -m benchmarks.speed`` in a checkout; docs/performance.md explains."""
