"""Upkeep of a running service: metrics, readiness, retention, exposure."""
