"""What looks after a running service: metrics, readiness, retention, exposure."""
