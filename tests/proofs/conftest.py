"""Proofs use the services and the clients that other tests use."""

from client.conftest import connect, fault, service
from service.conftest import database_url, document, finished, guarded_service, http, observed, postgres, settings, url

__all__ = [
    "connect", "database_url", "document", "fault", "finished", "guarded_service", "http", "observed", "postgres",
    "service", "settings", "url",
]  # fmt: skip
