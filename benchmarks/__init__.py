"""Accuracy and speed of contact_system against bars: ``python -m benchmarks`` from a checkout."""
